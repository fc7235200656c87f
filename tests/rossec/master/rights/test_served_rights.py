"""What a caller may subscribe and see of what a gateway serves."""

from collections.abc import Mapping
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ca.names import served_name
from grants.errors import GrantMissing
from grants.model import Right
from rossec.master.rights import access_rules
from rossec.master.rights.caller import Caller, Refused
from rossec.master.state.registry import Kind, NodeRef, Registry
from tests.rossec.master.fakes import ALL, anonymous, caller
from tests.rossec.master.rights.test_caller import POSE, visitor_of

SERVED = served_name(POSE)
PATTERNS = st.sampled_from(
    ["/**", "/gateway/**", "/gateway/hospital/**", SERVED, "/remote/**", POSE, "/robot/pose", "/*"]
)
RIGHTS = st.dictionaries(PATTERNS, st.integers(1, 255).map(Right), max_size=3)


def named(name: str, own: Mapping[str, Right], hospital: Mapping[str, Right]) -> Caller:
    return replace(visitor_of(hospital, own), name=name)


@given(RIGHTS, RIGHTS)
def test_own_grants_count_on_the_served_name_and_the_origins_at_the_origin(
    own: Mapping[str, Right], hospital: Mapping[str, Right]
) -> None:
    held = visitor_of(hospital, own)
    assert access_rules.may_be_served(held, POSE) is visitor_of({}, own).may(Right.SUBSCRIBE, SERVED)
    assert held.may(Right.SUBSCRIBE, POSE) is visitor_of(hospital).may(Right.SUBSCRIBE, POSE)
    assert access_rules.may_subscribe(held, POSE) is (
        access_rules.may_be_served(held, POSE) or held.may(Right.SUBSCRIBE, POSE)
    )
    assert access_rules.may_see_served(held, POSE) is visitor_of({}, own).may_see(SERVED)


@pytest.mark.parametrize(
    "own",
    [
        {},
        {"/remote/**": ALL},
        {POSE: ALL},
        {"/robot/pose": ALL},
        {SERVED: ALL ^ Right.SUBSCRIBE},
        {"/gateway/clinic/**": ALL},
        {"/gateway": ALL},
    ],
)
def test_no_other_own_right_is_enough(own: Mapping[str, Right]) -> None:
    assert not access_rules.may_subscribe(visitor_of(own=own), POSE)


def test_a_right_of_the_origin_on_a_served_name_is_on_its_own_gateway() -> None:
    held = visitor_of({"/gateway/hospital/**": ALL})
    assert not access_rules.may_subscribe(held, POSE)
    assert not held.may(Right.SUBSCRIBE, SERVED)
    assert held.may(Right.SUBSCRIBE, f"/remote/hospital{SERVED}")


@pytest.mark.parametrize(
    "alias",
    [
        "/remote/clinic/pose",
        "/remote/kitchen/robot/pose",
        "/remote",
        "/remote/hospital",
        "/remote/hospital/remote/clinic/pose",
    ],
)
def test_only_of_a_listed_domain_something_is_served(alias: str) -> None:
    held = visitor_of(own={"/gateway/**": ALL})
    assert not access_rules.may_be_served(held, alias)
    assert not access_rules.may_see_served(held, alias)


def test_to_an_own_name_no_served_name_belongs() -> None:
    held = visitor_of(own={"/gateway/**": ALL})
    assert not access_rules.may_be_served(held, "/robot/pose")
    assert access_rules.may_subscribe(held, SERVED)


@pytest.mark.parametrize("name", ["/gateway", "/gateway/attic", "/remote/hospital/robot"])
def test_gateways_and_foreigners_are_not_served(name: str) -> None:
    held = named(name, {"/**": ALL}, {})
    assert not access_rules.may_subscribe(held, POSE)
    assert not access_rules.may_see_served(held, POSE)
    origin = named(name, {}, {"/robot/pose": Right.SUBSCRIBE})
    assert access_rules.may_subscribe(origin, POSE) is name.startswith("/gateway")


@pytest.mark.parametrize("name", ["/gateway", "/gateway/attic"])
def test_gateways_offer_below_gateway(name: str) -> None:
    for offered in (SERVED, "/gateway/attic/get_loggers", "/pose"):
        access_rules.require_gateway(caller(name), offered)


@pytest.mark.parametrize(
    "who",
    [
        caller("/robot"),
        caller("/gateway_1"),
        caller("/gateways"),
        caller("/gateway/a/b"),
        caller("/remote/hospital/gateway"),
        caller("/remote/hospital/gateway/attic"),
        anonymous("/gateway"),
        replace(caller("/gateway"), certified="/gate"),
    ],
    ids=lambda who: who.display_name,
)
def test_nobody_else_does(who: Caller) -> None:
    for offered in (SERVED, "/gateway/x"):
        with pytest.raises(Refused, match="where only gateways of this domain publish"):
            access_rules.require_gateway(who, offered)
    access_rules.require_gateway(who, "/gateway")
    access_rules.require_gateway(who, "/gateways/x")


def test_the_number_of_gateways_is_limited() -> None:
    registry = Registry(1000)
    nodes = [NodeRef(f"/gateway/n{i}", f"http://h:{i + 1}/", b"k%d" % i) for i in range(65)]
    for node in nodes[:64]:
        access_rules.require_place(registry, SERVED, node)
        registry.register_publisher(SERVED, "*", node)
    with pytest.raises(Refused, match="64 gateways are registered"):
        access_rules.require_place(registry, SERVED, nodes[64])
    registry.register_publisher("/state", "*", nodes[64])  # it is registered, and serves nothing
    with pytest.raises(Refused, match="64 gateways are registered"):
        access_rules.require_place(registry, SERVED, nodes[64])
    access_rules.require_place(registry, SERVED, nodes[0])
    access_rules.require_place(registry, "/pose", nodes[64])
    registry.remove(Kind.PUBLISHER, SERVED, nodes[3].name)
    access_rules.require_place(registry, SERVED, nodes[64])


def test_the_refusal_names_both_ways() -> None:
    held = replace(visitor_of(), elsewhere={})
    with pytest.raises(GrantMissing, match=r"hospital:/robot/pose by the authority of") as caught:
        held.explain(Right.SUBSCRIBE, POSE)
    assert caught.value.hint == (
        "ask its authority for a grant, or this one for subscribe on "
        "/gateway/hospital/robot/pose, if a gateway serves it"
    )
    with pytest.raises(GrantMissing) as caught:
        held.explain(Right.CALL, POSE)
    assert caught.value.hint == "ask the authority for a grant"
