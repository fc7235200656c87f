"""`Access` with what a gateway serves: the own domain's grants, and only a gateway publishes it."""

from dataclasses import replace

import pytest

from ca.certificates import Identity
from ca.encoding import Value, encode
from ca.errors import NotAdmitted
from grants.errors import GrantError, GrantMissing
from grants.model import Right
from rossec.participant.access import Access
from tests.support.domains import Pair, SomeNode, domains, foreign, grant
from tests.support.pki import NOW, Site

ALIAS, SERVED, THERE = "/remote/hospital/ward/pose", "/gateway/hospital/ward/pose", "/ward/pose"
PUBLISH, SUBSCRIBE = Right.PUBLISH, Right.SUBSCRIBE


@pytest.fixture
def pair() -> Pair:
    pair = Pair(admitted=("/**",))
    pair.confirm_own()
    pair.confirm_foreign()
    return pair


def publishes(
    pair: Pair, peer: Identity, by: Site, name: str = SERVED, pattern: str = "/**", domain: str = ""
) -> str:
    """The name that `peer` publishes by a grant of one of the two authorities."""
    token = grant(by, peer.thumbprint, PUBLISH, pattern, domain=domain)
    presented = encode(list[Value]([token]))
    return Access(pair.trust_status).authorize(peer, presented, PUBLISH, name, NOW).name


@pytest.mark.parametrize("name", ["/gateway", "/gateway/ward"])
def test_a_gateway_publishes_by_a_grant_of_the_own_domain(pair: Pair, name: str) -> None:
    gateway = SomeNode(pair.home, name).identity
    assert publishes(pair, gateway, pair.home, pattern="/gateway/hospital/**") == SERVED
    for domain in ("", pair.home.anchor.domain):  # an authority that claims more than its own
        with pytest.raises(GrantError):
            publishes(pair, gateway, pair.hospital, domain=domain)
    with pytest.raises(GrantError):
        publishes(pair, gateway, pair.home, pattern=THERE)
    with pytest.raises(GrantError):
        publishes(pair, gateway, pair.home, pattern="/gateway/hospitals/**")


@pytest.mark.parametrize("name", ["/robot", "/gatewayx", "/gateway/a/b", "/master", "/relay"])
@pytest.mark.parametrize("published", [SERVED, "/gateway/x"])
def test_no_other_own_node_publishes_below_gateway_whatever_its_grant(
    pair: Pair, name: str, published: str
) -> None:
    node = SomeNode(pair.home, name).identity
    with pytest.raises(NotAdmitted, match="only a gateway of this domain does") as caught:
        publishes(pair, node, pair.home, published)
    assert "/gateway/NAME" in caught.value.hint


def test_no_other_own_node_provides_a_service_below_gateway(pair: Pair) -> None:
    for name, is_one in (("/robot", False), ("/gateway", True)):
        peer = SomeNode(pair.home, name).identity
        token = encode(list[Value]([grant(pair.home, peer.thumbprint, Right.PROVIDE, "/**")]))
        access = Access(pair.trust_status)
        if is_one:
            assert access.authorize(peer, token, Right.PROVIDE, SERVED, NOW).name == SERVED
        else:
            with pytest.raises(NotAdmitted, match="/robot provides /gateway/hospital/ward/pose"):
                access.authorize(peer, token, Right.PROVIDE, SERVED, NOW)


def test_no_foreign_gateway_publishes_here(pair: Pair) -> None:
    gateway = pair.peer(SomeNode(pair.hospital, "/gateway"))
    for site in (pair.home, pair.hospital):
        with pytest.raises(NotAdmitted, match="hospital:/gateway publishes"):
            publishes(pair, gateway, site)
    assert publishes(pair, gateway, pair.hospital, ALIAS) == ALIAS, "a foreign node as any"
    with pytest.raises(GrantError):
        publishes(pair, gateway, pair.home, ALIAS)


def test_a_name_with_a_tail_publishes_nothing_there(pair: Pair) -> None:
    gateway = replace(SomeNode(pair.home, "/gateway").identity, wildcard=True)
    with pytest.raises(NotAdmitted):
        publishes(pair, gateway, pair.home)


def test_the_two_names_of_one_topic_have_grants_of_their_own(pair: Pair) -> None:
    """What is held for one of them is shown for it alone, and proves nothing of the other."""
    key = bytes(32)
    own, theirs = (grant(site, key, SUBSCRIBE, "/**") for site in (pair.home, pair.hospital))
    access = Access(pair.trust_status, [own, theirs])
    assert access.present(SUBSCRIBE, SERVED, NOW) == encode([own])
    assert access.present(SUBSCRIBE, ALIAS, NOW) == encode([theirs])
    viewer = SomeNode(pair.home, "/viewer").identity
    for site, name in ((pair.home, ALIAS), (pair.hospital, SERVED)):
        token = grant(site, viewer.thumbprint, SUBSCRIBE, "/**")
        with pytest.raises(GrantError):
            access.authorize(viewer, encode([token]), SUBSCRIBE, name, NOW)
    with pytest.raises(GrantMissing):
        access.authorize(viewer, encode([]), SUBSCRIBE, SERVED, NOW)


def test_either_right_lets_subscribe_to_an_alias_and_no_other_right(pair: Pair) -> None:
    key, other = bytes(32), "/remote/hospital/other"
    served = Access(pair.trust_status, [grant(pair.home, key, SUBSCRIBE, SERVED)])
    assert served.holds(SUBSCRIBE, ALIAS, NOW)
    assert served.holds(SUBSCRIBE, SERVED, NOW)
    assert not served.holds(SUBSCRIBE, THERE, NOW)
    assert not served.holds(SUBSCRIBE, other, NOW)
    assert not served.holds(Right.CALL, ALIAS, NOW)
    origins = Access(pair.trust_status, [grant(pair.hospital, key, SUBSCRIBE, THERE)])
    assert origins.holds(SUBSCRIBE, ALIAS, NOW)
    assert not origins.holds(SUBSCRIBE, SERVED, NOW)
    assert origins.covers(SUBSCRIBE, ALIAS, NOW)
    assert not served.covers(SUBSCRIBE, ALIAS, NOW), "to a gateway it is the origin's alone"
    publishing = Access(pair.trust_status, [grant(pair.home, key, PUBLISH, SERVED)])
    assert not publishing.holds(SUBSCRIBE, ALIAS, NOW)
    assert not publishing.holds(PUBLISH, ALIAS, NOW)


def test_what_is_served_ends_with_its_label(pair: Pair) -> None:
    gateway = SomeNode(pair.home, "/gateway").identity
    key = bytes(32)
    access = Access(pair.trust_status, [grant(pair.home, key, SUBSCRIBE, "/**")])
    pair.anchors.update(domains(pair.home, foreign(pair.hospital, label="clinic"), seq=2))
    with pytest.raises(NotAdmitted, match="no domain is called hospital here"):
        publishes(pair, gateway, pair.home)
    with pytest.raises(NotAdmitted):
        access.present(SUBSCRIBE, SERVED, NOW)
    assert not access.holds(SUBSCRIBE, ALIAS, NOW)
    assert access.holds(SUBSCRIBE, "/remote/clinic/pose", NOW)
    graph = Access(pair.trust_status, [grant(pair.home, key, Right.GRAPH, "/**")])
    assert graph.holds(Right.GRAPH, SERVED, NOW), "what tools list is no message"
