from dataclasses import dataclass

import pytest

from ca.certificates import Identity
from grants.decision import authorize
from grants.document import open_grant
from grants.model import Right
from rossec.errors import LimitExceeded
from rossec.inprocess.live_connections import PEER_CONNECTIONS, LiveConnection, LiveConnections
from tests.support.authority import DAY, EnrolledNode, Site


@dataclass
class Stream:
    peer: Identity


def live_connection(site: Site, member: EnrolledNode, lifetime: int = DAY) -> LiveConnection:
    grant = site.grant(member, {"/t": Right.SUBSCRIBE}, lifetime=lifetime)
    opened = open_grant(grant, site.anchor.public_key, site.now, domain="home")
    decision = authorize(
        [opened], Right.SUBSCRIBE, "/t", holder=member.thumbprint, now=site.now,
        check=lambda *_: None,
    )  # fmt: skip
    return LiveConnection(Stream(member.identity), decision)


def test_only_connections_with_a_reason_are_closed() -> None:
    site = Site()
    a, b = (live_connection(site, site.enroll(name)) for name in ("/a", "/b"))
    closed: list[str] = []
    connections = LiveConnections()
    connections.add(a, lambda: closed.append("a"))
    connections.add(b, lambda: closed.append("b"))
    assert len(connections) == 2
    ended = connections.close_ended(lambda each: "it is a" if each is a else None)
    assert (ended, closed, len(connections)) == ([(a, "it is a")], ["a"], 1)
    connections.discard(b)
    connections.discard(b)
    assert connections.next_expiry is None
    assert connections.streams() == []


def test_the_next_expiry_is_the_earliest() -> None:
    site = Site()
    connections = LiveConnections()
    for name, lifetime in (("/a", 60), ("/b", 30)):
        connections.add(live_connection(site, site.enroll(name), lifetime), lambda: None)
    assert connections.next_expiry == site.now + 30


def test_the_connections_of_one_peer_are_limited() -> None:
    site = Site()
    eve, other = (site.enroll(name).identity for name in ("/eve", "/other"))
    connections = LiveConnections()
    closed: list[object] = []
    for number in range(PEER_CONNECTIONS):
        connections.admit(number, eve, lambda number=number: closed.append(number))  # type: ignore[misc]
    with pytest.raises(LimitExceeded, match="/eve has 64 connections"):
        connections.admit("more", eve, lambda: None)
    connections.admit("other", other, lambda: closed.append("other"))
    connections.forget(0)
    connections.forget(0)
    connections.admit("again", eve, lambda: closed.append("again"))
    connections.close_revoked(lambda peer: peer is other)
    assert closed == ["other"]
    connections.forget("other")
    connections.close_revoked(lambda _: True)
    assert "other" not in closed[1:]


def test_plain_connections_are_counted_by_address() -> None:
    connections = LiveConnections()
    for number in range(PEER_CONNECTIONS):
        connections.admit_plain(number, "10.0.0.1")
    with pytest.raises(LimitExceeded, match=r"10\.0\.0\.1 has 64 connections"):
        connections.admit_plain("more", "10.0.0.1")
    connections.admit_plain("other", "10.0.0.2")
    connections.forget(0)
    connections.admit_plain("again", "10.0.0.1")
