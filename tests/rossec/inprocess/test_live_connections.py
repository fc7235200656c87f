from dataclasses import dataclass

import pytest

from ca.certificates import Identity
from grants.decision import authorize
from grants.document import open_grant
from grants.model import Right
from rossec.errors import LimitExceeded
from rossec.inprocess.live_connections import PEER_CONNECTIONS, LiveConnection, LiveConnections
from tests.support.authority import DAY, Member, Site


@dataclass
class Stream:
    peer: Identity


def link(site: Site, member: Member, lifetime: int = DAY) -> LiveConnection:
    grant = site.grant(member, {"/t": Right.SUBSCRIBE}, lifetime=lifetime)
    opened = open_grant(grant, site.anchor.public_key, site.now, domain="home")
    decision = authorize(
        [opened], Right.SUBSCRIBE, "/t", holder=member.thumbprint, now=site.now,
        check=lambda *_: None,
    )  # fmt: skip
    return LiveConnection(Stream(member.identity), decision)


def test_those_with_a_reason_are_cut_and_no_others() -> None:
    site = Site()
    a, b = (link(site, site.enroll(name)) for name in ("/a", "/b"))
    cut: list[str] = []
    links = LiveConnections()
    links.add(a, lambda: cut.append("a"))
    links.add(b, lambda: cut.append("b"))
    assert len(links) == 2
    ended = links.must_end(lambda each: "it is a" if each is a else None)
    assert (ended, cut, len(links)) == ([(a, "it is a")], ["a"], 1)
    links.discard(b)
    links.discard(b)
    assert links.soonest is None
    assert links.streams() == []


def test_the_soonest_end_is_known() -> None:
    site = Site()
    links = LiveConnections()
    for name, lifetime in (("/a", 60), ("/b", 30)):
        links.add(link(site, site.enroll(name), lifetime), lambda: None)
    assert links.soonest == site.now + 30


def test_one_peer_holds_only_so_many_connections() -> None:
    site = Site()
    eve, other = (site.enroll(name).identity for name in ("/eve", "/other"))
    links = LiveConnections()
    cut: list[object] = []
    for number in range(PEER_CONNECTIONS):
        links.admit(number, eve, lambda number=number: cut.append(number))  # type: ignore[misc]
    with pytest.raises(LimitExceeded, match="/eve has 64 connections"):
        links.admit("more", eve, lambda: None)
    links.admit("other", other, lambda: cut.append("other"))
    links.forget(0)
    links.forget(0)
    links.admit("again", eve, lambda: cut.append("again"))
    links.cut_peers(lambda peer: peer is other)
    assert cut == ["other"]
    links.forget("other")
    links.cut_peers(lambda _: True)
    assert "other" not in cut[1:]


def test_a_plain_peer_is_known_by_its_address() -> None:
    links = LiveConnections()
    for number in range(PEER_CONNECTIONS):
        links.admit_plain(number, "10.0.0.1")
    with pytest.raises(LimitExceeded, match=r"10\.0\.0\.1 has 64 connections"):
        links.admit_plain("more", "10.0.0.1")
    links.admit_plain("other", "10.0.0.2")
    links.forget(0)
    links.admit_plain("again", "10.0.0.1")
