from dataclasses import replace

import pytest

from ca.certificates import Identity
from ca.errors import NameRefused
from ca.names import MAX_NAME
from rossec.participant.access import granted_name, is_own_gateway, possible_names, wire_name
from tests.support.pki import NOW, Site

ALIAS, ORIGIN, SERVED = "/remote/hospital/ward/pose", "/ward/pose", "/gateway/hospital/ward/pose"
TOO_LONG = f"/remote/hospital/{'a' * (MAX_NAME - len('/remote/hospital/'))}"


@pytest.fixture(scope="module")
def robot() -> Identity:
    site = Site.create()
    return site.anchor.verify([site.leaf("/robot")], NOW)


def foreign(identity: Identity, name: str) -> Identity:
    """The node of this name in the hospital's domain."""
    alias = f"/remote/hospital{name}"
    return replace(identity, domain="hospital", name=alias, certified=name, root=b"r")


@pytest.mark.parametrize("name", ["/gateway", "/gateway/ward"])
def test_a_gateway_is_asked_for_what_it_serves(robot: Identity, name: str) -> None:
    gateway = replace(robot, name=name)
    assert is_own_gateway(gateway)
    assert granted_name(gateway, ALIAS) == wire_name(gateway, ALIAS) == SERVED
    for own in (ORIGIN, SERVED, "/gateway", "/remotely/pose"):  # a name of the own domain
        assert granted_name(gateway, own) == wire_name(gateway, own) == own


@pytest.mark.parametrize(
    "name", ["/robot", "/gatewayx", "/gateway/a/b", "/gateway_1", "/Gateway", "/my/gateway", "/master"]
)
def test_every_other_node_is_asked_by_the_origins_name(robot: Identity, name: str) -> None:
    peer = replace(robot, name=name)
    assert not is_own_gateway(peer)
    assert (granted_name(peer, ALIAS), wire_name(peer, ALIAS)) == (ALIAS, ORIGIN)


@pytest.mark.parametrize("name", ["/gateway", "/gateway/ward", "/robot"])
def test_another_domains_gateway_is_a_foreign_node_as_any(robot: Identity, name: str) -> None:
    peer = foreign(robot, name)
    assert not is_own_gateway(peer)
    assert (granted_name(peer, ALIAS), wire_name(peer, ALIAS)) == (ALIAS, ORIGIN)
    assert not is_own_gateway(replace(peer, name=name)), "if its alias were ever forgotten"


@pytest.mark.parametrize("own", ["/gateway", "/gateway/ward"])
def test_a_gateway_is_fed_by_the_origin_alone(robot: Identity, own: str) -> None:
    for name in ("/gateway", "/gateway/ward"):
        gateway = replace(robot, name=name)
        assert granted_name(gateway, ALIAS, own) == ALIAS
        assert wire_name(gateway, ALIAS, own) == ORIGIN
        assert wire_name(gateway, SERVED, own) == SERVED, "what it asks for itself"
        assert wire_name(gateway, ALIAS, "/gatewayx") == SERVED


def test_a_name_with_a_tail_is_no_gateway(robot: Identity) -> None:
    assert not is_own_gateway(replace(robot, name="/gateway", wildcard=True))


def test_what_is_no_alias_of_a_name_is_asked_of_nobody(robot: Identity) -> None:
    gateway = replace(robot, name="/gateway")
    for wrong in ("/remote", "/remote/hospital", "/remote/1/pose"):
        for peer in (robot, gateway):
            with pytest.raises(NameRefused):
                wire_name(peer, wrong)
    with pytest.raises(NameRefused):  # the served name is longer than the alias
        wire_name(gateway, TOO_LONG)
    with pytest.raises(NameRefused, match="an alias at the origin itself"):
        wire_name(gateway, f"/remote/hospital{ALIAS}")


def test_either_of_two_rights_allows_an_alias_and_one_any_other_name() -> None:
    assert possible_names(ALIAS) == (ALIAS, SERVED)
    assert possible_names(SERVED) == (SERVED,)
    assert possible_names(ORIGIN) == (ORIGIN,)
    assert possible_names("/remote/hospital") == ("/remote/hospital",)
    assert possible_names(TOO_LONG) == (TOO_LONG,)
