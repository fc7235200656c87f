"""Connections with foreign domains: what ends them, and when."""

from dataclasses import replace
from typing import Any

import pytest

from ca.certificates import Identity
from ca.encoding import encode
from grants.model import Permission, Restriction, Right
from rossec.clock import Clock
from rossec.errors import LimitExceeded
from rossec.participant.access import Access
from rossec.participant.authorized import STALE_GRACE, AuthorizedConnection
from rossec.participant.connections import ConnectionTable
from tests.rossec.participant.test_connections import Connection, FakeStream, table
from tests.support.domains import Pair, SomeNode, domains, foreign, grant
from tests.support.pki import NOW


@pytest.fixture(autouse=True)
def _clock(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rossec.clock.HOST", Clock(lambda: NOW))


def admitted(pair: Pair, peer: Identity, token: bytes, right: Right, name: str) -> Any:
    """A connection of `peer`, which showed `token`, and the table it is in."""
    decision = Access(pair.trust_status).authorize(peer, encode([token]), right, name, NOW)
    stream: Any = FakeStream(ends=NOW + 1000)
    stream.peer = peer
    connections = table(pair.trust_status)
    connection: Connection = AuthorizedConnection(stream, decision, None)
    connections.add(connection)
    return connections, stream


@pytest.fixture
def pair() -> Pair:
    pair = Pair()
    pair.confirm_own()
    pair.confirm_foreign()
    return pair


def visiting(pair: Pair) -> Any:
    """The hospital's robot reads a topic of the home."""
    token = grant(pair.home, pair.robot.identity.thumbprint, Right.SUBSCRIBE, "/pose")
    return admitted(pair, pair.peer(), token, Right.SUBSCRIBE, "/pose")


def visited(pair: Pair) -> Any:
    """A node of the home reads a topic of the hospital's robot."""
    token = grant(pair.hospital, pair.robot.identity.thumbprint, Right.PUBLISH, "/ward/pose")
    return admitted(pair, pair.peer(), token, Right.PUBLISH, "/remote/hospital/ward/pose")


def ends(connections: Any, stream: Any, now: int = NOW) -> str:
    connections.cut_ended(now)
    return "".join(stream.reasons)


@pytest.mark.parametrize("connect", [visiting, visited])
def test_a_foreign_connection_ends_by_its_domains_list(pair: Pair, connect: Any) -> None:
    connections, stream = connect(pair)
    assert (ends(connections, stream), connections.domains) == ("", {"hospital.example"})
    pair.confirm_foreign(pair.robot.identity.thumbprint, seq=2)
    assert ends(connections, stream) == f"{pair.robot.identity.thumbprint.hex()} is revoked"


@pytest.mark.parametrize("connect", [visiting, visited])
def test_a_foreign_connection_ends_by_the_own_list(pair: Pair, connect: Any) -> None:
    connections, stream = connect(pair)
    pair.confirm_own(pair.robot.identity.thumbprint, seq=2)
    assert "is revoked" in ends(connections, stream)


@pytest.mark.parametrize("connect", [visiting, visited])
def test_a_foreign_connection_ends_with_its_grant(pair: Pair, connect: Any) -> None:
    connections, stream = connect(pair)
    (connection,) = connections
    (grant_id,) = connection.decision.grant_ids
    pair.confirm_foreign(grant_id, seq=2)
    assert ends(connections, stream) == f"{grant_id.hex()} is revoked"


@pytest.mark.parametrize("connect", [visiting, visited])
def test_the_removal_of_a_domain_ends_its_connections(pair: Pair, connect: Any) -> None:
    connections, stream = connect(pair)
    pair.anchors.update(domains(pair.home, seq=2))
    assert "'hospital.example' is not listed here" in ends(connections, stream)


@pytest.mark.parametrize("connect", [visiting, visited])
def test_the_end_of_trust_ends_connections_to_the_second(pair: Pair, connect: Any) -> None:
    until = NOW + 80
    pair.anchors.update(domains(pair.home, foreign(pair.hospital, until=until), seq=2))
    connections, stream = connect(pair)
    assert connections.next_expiry == until - 1
    assert ends(connections, stream, until - 2) == ""
    assert ends(connections, stream, until) != ""


@pytest.mark.parametrize("connect", [visiting, visited])
@pytest.mark.parametrize("changes", [{"label": "clinic"}, {"admitted": ("/nobody",)}])
def test_other_terms_of_trust_end_connections(pair: Pair, connect: Any, changes: dict[str, Any]) -> None:
    connections, stream = connect(pair)
    pair.anchors.update(domains(pair.home, foreign(pair.hospital, **changes), seq=2))
    assert "is not admitted here any more" in ends(connections, stream)


def test_a_guest_there_is_cut_when_the_label_stands_for_nobody(pair: Pair) -> None:
    """An own node that published at the hospital: its own identity is as good as before."""
    guest = SomeNode(pair.home, "/guest")
    token = grant(pair.hospital, guest.identity.thumbprint, Right.PUBLISH, "/ward/pose")
    name = "/remote/hospital/ward/pose"
    connections, stream = admitted(pair, guest.identity, token, Right.PUBLISH, name)
    assert ends(connections, stream) == ""
    relabeled = foreign(pair.hospital, label="clinic")
    pair.anchors.update(domains(pair.home, relabeled, seq=2))
    assert ends(connections, stream) == "hospital is no longer the domain it was"


def test_what_a_gateway_serves_is_cut_when_the_label_stands_for_nobody(pair: Pair) -> None:
    """The gateway itself is a node of the home; and so is the viewer that it serves."""
    served = "/gateway/hospital/ward/pose"
    held = []
    for name, right in (("/gateway", Right.PUBLISH), ("/viewer", Right.SUBSCRIBE)):
        node = SomeNode(pair.home, name)
        token = grant(pair.home, node.identity.thumbprint, right, served)
        held.append(admitted(pair, node.identity, token, right, served))
        assert ends(*held[-1]) == ""
    pair.anchors.update(domains(pair.home, foreign(pair.hospital, label="clinic"), seq=2))
    for connections, stream in held:
        assert ends(connections, stream) == "hospital is no longer the domain it was"


@pytest.mark.parametrize("connect", [visiting, visited])
def test_a_foreign_connection_outlives_stale_foreign_lists_for_the_grace_period(
    pair: Pair, connect: Any
) -> None:
    connections, stream = connect(pair)
    last = NOW + 3600 + STALE_GRACE
    pair.confirm_own(seq=2, now=last)
    assert ends(connections, stream, last - 1) == ""
    assert "of domain hospital: the last confirmation expired" in ends(connections, stream, last)


def test_a_foreign_connection_that_is_kept_when_stale_ends_with_trust_all_the_same(pair: Pair) -> None:
    kept = Permission("/stop", Right.SUBSCRIBE, Restriction(keep_when_stale=True))
    token = grant(pair.home, pair.robot.identity.thumbprint, Right.SUBSCRIBE, "/stop", permissions=(kept,))
    connections, stream = admitted(pair, pair.peer(), token, Right.SUBSCRIBE, "/stop")
    assert ends(connections, stream, NOW + 3600 + 10 * STALE_GRACE) == ""
    pair.anchors.update(domains(pair.home, seq=2))
    assert "not listed" in ends(connections, stream)


def test_an_expired_list_of_domains_cuts_nobody(pair: Pair) -> None:
    listed = foreign(pair.hospital)
    pair.anchors.update(domains(pair.home, listed, seq=2, life=50))
    connections, stream = visiting(pair)
    assert ends(connections, stream, NOW + 60) == ""


def test_a_foreigner_that_only_connected_is_cut_too(pair: Pair) -> None:
    connections, stream = table(pair.trust_status), FakeStream(ends=NOW + 1000)
    reasons = stream.reasons
    connections.accept(stream, pair.peer())
    connections.cut_ended(NOW)
    assert reasons == []
    pair.confirm_foreign(pair.robot.identity.thumbprint, seq=2)
    connections.cut_ended(NOW)
    pair.anchors.update(domains(pair.home, seq=2))
    connections.cut_ended(NOW)
    assert reasons[0] == "the peer's identity is revoked"
    assert "not listed" in reasons[1]


async def test_the_master_of_another_domain_has_no_more_connections_than_others(pair: Pair) -> None:
    connections = table(pair.trust_status, most=0)
    served: list[Any] = []

    async def handler(stream: Any) -> None:
        served.append(stream)

    stream: Any = FakeStream(ends=NOW + 1000)
    stream.peer = pair.peer(pair.master)
    await connections.bounded(handler)(stream)
    assert served == []


def test_a_foreign_domain_has_as_many_connections_as_one_peer(pair: Pair) -> None:
    connections = ConnectionTable[Any](pair.trust_status, most=2)
    first, second = pair.peer(), replace(pair.peer(), thumbprint=b"another key" + bytes(21))
    streams = [FakeStream() for _ in range(4)]
    connections.accept(streams[0], first)
    connections.accept(streams[1], second)
    with pytest.raises(LimitExceeded, match="has 2 connections already"):
        connections.accept(streams[2], replace(second, thumbprint=bytes(32)))
    own = replace(first, certified="", name="/own")
    connections.accept(streams[3], own)
    connections.forget(streams[0])
    connections.accept(streams[2], second)
