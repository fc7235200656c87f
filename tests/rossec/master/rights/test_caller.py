"""Callers of the master: rights on own names, on aliases, and as foreigners."""

import re
from collections.abc import Mapping
from dataclasses import replace

import pytest

from ca.errors import HintedError, NotAdmitted
from grants.decision import Reach
from grants.errors import GrantMissing
from grants.model import Permission, Right
from rossec.master.rights.caller import OWN_DOMAIN, Caller, OriginRights, Refused
from tests.rossec.master.fakes import ALL, caller, refuse

POSE = "/remote/hospital/robot/pose"
FORBIDDEN = [Right.PUBLISH, Right.PROVIDE, Right.PARAM_SET]


def reach(rights: Mapping[str, Right]) -> Reach:
    return Reach(Permission(pattern, right) for pattern, right in rights.items())


def labels(label: str) -> str | None:
    return {"hospital": "hospital.example", "kitchen": OWN_DOMAIN}.get(label)


def visitor_of(hospital: Mapping[str, Right] | None = None, own: Mapping[str, Right] | None = None) -> Caller:
    """A node of the own domain that holds grants of the hospital."""
    elsewhere = {"hospital.example": OriginRights(reach(hospital or {}), refuse)}
    return replace(caller("/robot", own), elsewhere=elsewhere, domain_of=labels)


@pytest.mark.parametrize("right", list(Right), ids=str)
def test_own_grants_give_on_aliases_what_concerns_the_own_master(right: Right) -> None:
    held = visitor_of(own={"/**": ALL, "/remote/**": ALL})
    assert held.may(right, POSE) == (right in Right.GRAPH | Right.ADMIN)


@pytest.mark.parametrize("right", list(Right), ids=str)
def test_grants_of_the_origin_give_what_is_not_done_here(right: Right) -> None:
    held = visitor_of({"/**": ALL})
    allowed = Right.SUBSCRIBE | Right.CALL | Right.PARAM_GET | Right.GRAPH
    assert held.may(right, POSE) == (right in allowed)


def test_a_grant_of_the_origin_is_for_the_origins_name_alone() -> None:
    held = visitor_of({"/robot/pose": Right.SUBSCRIBE})
    assert held.may(Right.SUBSCRIBE, POSE)
    assert not held.may(Right.SUBSCRIBE, "/robot/pose")
    assert not held.may(Right.SUBSCRIBE, "/remote/clinic/robot/pose")
    assert not held.may(Right.SUBSCRIBE, "/remote/kitchen/robot/pose")


@pytest.mark.parametrize("right", [Right.SUBSCRIBE, Right.CALL, Right.PARAM_GET], ids=str)
def test_at_another_site_of_the_own_domain_own_grants_count(right: Right) -> None:
    held = visitor_of(own={"/robot/pose": right})
    assert held.may(right, "/remote/kitchen/robot/pose")
    assert not held.may(right, "/remote/kitchen/robot/other")
    assert not held.may(right, POSE)


@pytest.mark.parametrize("right", FORBIDDEN, ids=str)
def test_nothing_is_done_below_remote_even_at_an_own_site(right: Right) -> None:
    assert not visitor_of(own={"/**": ALL}).may(right, "/remote/kitchen/robot/pose")


@pytest.mark.parametrize("name", ["/remote", "/remote/hospital", "/remote/1/x", "/remote/hospital/"])
def test_what_names_no_origin_is_denied(name: str) -> None:
    held = visitor_of({"/**": ALL}, {"/**": ALL})
    assert not any(held.may(right, name) for right in [*FORBIDDEN, Right.SUBSCRIBE, Right.CALL])
    with pytest.raises(HintedError):
        held.explain(Right.SUBSCRIBE, name)


def test_a_name_that_only_begins_like_remote_is_an_own_name() -> None:
    assert visitor_of(own={"/remote_arm/pose": Right.PUBLISH}).may(Right.PUBLISH, "/remote_arm/pose")


@pytest.mark.parametrize("right", [Right.PUBLISH, Right.SUBSCRIBE, Right.GRAPH], ids=str)
def test_an_alias_is_seen_with_a_right_at_the_origin(right: Right) -> None:
    held = visitor_of({"/robot/pose": right})
    assert held.may_see(POSE)
    assert not held.may_see("/remote/hospital/robot/other")


def test_an_alias_is_seen_with_graph_here_and_by_no_other_own_right() -> None:
    assert visitor_of(own={"/remote/**": Right.GRAPH}).may_see(POSE)
    assert not visitor_of(own={"/**": ALL & ~Right.GRAPH}).may_see(POSE)


def test_the_authority_and_own_masters_see_everything() -> None:
    plain = caller("/x")
    for who in (replace(plain, is_authority=True), replace(plain, is_own_master=True)):
        assert who.may_see(POSE)
        assert who.may_see("/a")
        assert who.may(Right.GRAPH, "/a")
        assert who.may(Right.GRAPH, POSE)
        assert not who.may(Right.SUBSCRIBE, "/a")
        assert not who.may(Right.SUBSCRIBE, POSE)
    assert not plain.may_see("/a")


def test_parameters_of_an_origin_are_read_with_its_grants() -> None:
    held = visitor_of({"/robot/**": Right.PARAM_GET}, {"/**": ALL})
    assert held.may_all_below(Right.PARAM_GET, "/remote/hospital/robot")
    assert not held.may_all_below(Right.PARAM_GET, "/remote/hospital")
    assert held.may_some_below(Right.PARAM_GET, "/remote/hospital")
    assert not held.may_some_below(Right.PARAM_GET, "/remote")
    assert not held.may_some_below(Right.PARAM_GET, "/remote/clinic")
    assert not held.may_all_below(Right.PARAM_SET, "/remote/hospital/robot")
    assert held.may_all_below(Right.PARAM_GET, "/remote/kitchen")
    assert held.may_all_below(Right.PARAM_GET, "/robot")


FOREIGNER = "/remote/hospital/rounds/robot3"


def test_a_foreigner_calls_itself_by_its_name_at_home() -> None:
    found = caller(FOREIGNER).acting_as("/rounds/robot3")
    assert found.name == FOREIGNER
    assert found.display_name == found.identity == "hospital:/rounds/robot3"


@pytest.mark.parametrize(
    "name", [FOREIGNER, "/rounds/robot4", "/remote/hospital/rounds/robot4", "/master", ""]
)
def test_a_foreigner_calls_itself_by_no_other_name(name: str) -> None:
    with pytest.raises(Refused, match=r"belongs to hospital:/rounds/robot3"):
        caller(FOREIGNER).acting_as(name)


def test_a_foreigner_sees_and_uses_no_alias() -> None:
    found = replace(caller(FOREIGNER, {"/**": ALL}), domain_of=labels)
    assert found.may(Right.SUBSCRIBE, "/robot/pose")
    for name in ("/remote/clinic/x", "/remote/kitchen/x", POSE):
        assert not any(found.may(right, name) for right in Right)
        assert not found.may_see(name)
        assert not found.may_some_below(Right.PARAM_GET, name)


def test_an_export_bounds_what_grants_give_a_foreigner() -> None:
    exported = reach({"/robot/**": Right.SUBSCRIBE})
    found = replace(caller(FOREIGNER, {"/**": ALL}), exported=exported)
    assert found.may(Right.SUBSCRIBE, "/robot/pose")
    assert found.may_see("/robot/pose")
    assert not found.may(Right.PUBLISH, "/robot/pose")
    assert not found.may(Right.SUBSCRIBE, "/lamp")
    assert not found.may_see("/lamp")


def test_an_export_bounds_the_trees_of_parameters_of_a_foreigner() -> None:
    exported = reach({"/robot/speed": Right.PARAM_GET, "/robot/arm/**": Right.PARAM_GET})
    found = replace(caller(FOREIGNER, {"/**": ALL}), exported=exported)
    assert not found.may_all_below(Right.PARAM_GET, "/robot")
    assert not found.may_all_below(Right.PARAM_GET, "/")
    assert found.may_all_below(Right.PARAM_GET, "/robot/arm")
    assert not found.may_all_below(Right.PARAM_SET, "/robot/arm")
    assert found.may_some_below(Right.PARAM_GET, "/robot")
    assert not found.may_some_below(Right.PARAM_GET, "/lamp")


def test_the_refusal_of_an_export_says_so() -> None:
    found = replace(caller(FOREIGNER, {"/**": ALL}), exported=reach({}), authorize=lambda *_: None)
    with pytest.raises(GrantMissing, match="not exported to this domain"):
        found.explain(Right.SUBSCRIBE, "/lamp")


def test_the_refusal_names_the_origin() -> None:
    with pytest.raises(GrantMissing, match=re.escape("publish on hospital:/robot/pose")):
        visitor_of(own={"/**": ALL}).explain(Right.PUBLISH, POSE)


def test_the_grants_of_the_origin_explain_a_refusal() -> None:
    asked: list[tuple[Right, str]] = []
    rights = OriginRights(reach({}), lambda right, name: asked.append((right, name)))
    held = replace(visitor_of(), elsewhere={"hospital.example": rights})
    with pytest.raises(GrantMissing):
        held.explain(Right.SUBSCRIBE, POSE)
    assert asked == [(Right.SUBSCRIBE, "/robot/pose")]


def test_patterns_of_all_domains_count_for_the_cost_of_a_query() -> None:
    many = {f"/a{number}/*/x": Right.SUBSCRIBE for number in range(64)}
    assert visitor_of(many).patterns(Right.SUBSCRIBE) == 64
    assert visitor_of(many).names_per_yield < visitor_of().names_per_yield


def test_a_refusal_says_what_the_label_means_to_own_nodes_alone() -> None:
    held = replace(visitor_of(own={"/**": ALL}), elsewhere={})
    with pytest.raises(NotAdmitted, match="no domain is called clinic here"):
        held.explain(Right.SUBSCRIBE, "/remote/clinic/x")
    with pytest.raises(GrantMissing, match=r"hospital:/x by the authority of hospital\.example"):
        held.explain(Right.SUBSCRIBE, "/remote/hospital/x")
    with pytest.raises(GrantMissing, match=r"on /remote$"):
        held.explain(Right.SUBSCRIBE, "/remote")
    foreign = replace(held, name="/remote/hospital/robot")
    with pytest.raises(GrantMissing, match=r"on clinic:/x$"):
        foreign.explain(Right.SUBSCRIBE, "/remote/clinic/x")
