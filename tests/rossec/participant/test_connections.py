import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from ca.revocation.state import Revocations, Timestamp, digest
from rossec.net.aio.server import Handler
from rossec.participant import connections
from rossec.participant.connections import (
    STALE_GRACE,
    AcceptedConnections,
    termination_reason,
)
from tests.support.site import Site

NOW = int(time.time())
GRANT = b"g" * 16
KEY, ABOVE = b"k" * 32, b"i" * 32


class FakeConnection:
    def __init__(self, ends: int = NOW + 1000, keep: bool = False) -> None:
        self.stream: Any = SimpleNamespace(peer=SimpleNamespace(keys=(KEY, ABOVE)))
        self.decision: Any = SimpleNamespace(grant_ids=(GRANT,), keep_when_stale=keep)
        self.ends = ends


@pytest.fixture
def site(tmp_path: Path) -> Site:
    return Site(tmp_path / "site", clock=lambda: NOW)


def revocations(site: Site) -> Revocations:
    held = Revocations(site.anchor.public_key)
    data = site.authority.store.newest_list()
    assert data is not None
    held.update(data, NOW)
    assert held.current is not None
    held.confirm(Timestamp(held.current.seq, digest(data), NOW, 30), NOW)
    return held


def test_a_valid_connection_stays_open(site: Site) -> None:
    assert termination_reason(FakeConnection(), revocations(site), NOW) is None


@pytest.mark.parametrize("late", [0, 1])
def test_a_connection_is_closed_in_the_second_it_expires(site: Site, late: int) -> None:
    assert termination_reason(FakeConnection(ends=NOW), revocations(site), NOW - 1) is None
    reason = termination_reason(FakeConnection(ends=NOW), revocations(site), NOW + late)
    assert reason == "its grant or its certificate has expired"


@pytest.mark.parametrize("entry", [GRANT, KEY, ABOVE])
def test_a_revoked_grant_or_key_closes_the_connection(site: Site, entry: bytes) -> None:
    site.authority.revoke(entry, "", NOW)
    assert (
        termination_reason(FakeConnection(), revocations(site), NOW) == f"{entry.hex()} is revoked"
    )


def test_a_connection_outlives_stale_revocations_for_the_grace_period(site: Site) -> None:
    held = revocations(site)
    last = held.fresh_until + STALE_GRACE
    assert termination_reason(FakeConnection(), held, last - 1) is None
    assert "the last confirmation expired" in (
        termination_reason(FakeConnection(), held, last) or ""
    )


def test_a_connection_is_closed_without_a_revocation_list(site: Site) -> None:
    never = Revocations(site.anchor.public_key)
    assert termination_reason(FakeConnection(), never, NOW) is not None


def test_a_connection_with_on_stale_keep_ends_by_revocation_or_expiry_only(site: Site) -> None:
    never = Revocations(site.anchor.public_key)
    held = revocations(site)
    long_after = held.fresh_until + 10 * STALE_GRACE
    assert termination_reason(FakeConnection(keep=True), never, NOW) is None
    assert (
        termination_reason(FakeConnection(ends=long_after + 1, keep=True), held, long_after) is None
    )
    assert termination_reason(FakeConnection(keep=True), held, NOW + 1000) is not None
    site.authority.revoke(GRANT, "", NOW)
    assert termination_reason(
        FakeConnection(ends=long_after + 1, keep=True), revocations(site), long_after
    ) == (f"{GRANT.hex()} is revoked")


def test_a_revoked_grant_closes_the_connection_during_the_grace_period(site: Site) -> None:
    site.authority.revoke(GRANT, "", NOW)
    held = revocations(site)
    assert (
        termination_reason(FakeConnection(), held, held.fresh_until + 1)
        == f"{GRANT.hex()} is revoked"
    )


class Stream:
    """An accepted connection of the peer `name`, with the keys of its chain."""

    def __init__(self, name: str, key: bytes = KEY) -> None:
        self.peer = SimpleNamespace(name=name, thumbprint=key, keys=(key, ABOVE))
        self.reasons: list[str] = []
        self.on_closed: list[Callable[[], None]] = []

    def abort(self, reason: str) -> None:
        self.reasons.append(reason)

    def when_closed(self, call: Callable[[], None]) -> None:
        self.on_closed.append(call)


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connections, "PEER_CONNECTIONS", 2)


async def accept(handler: Handler[Any], *streams: Stream) -> None:
    for stream in streams:
        await handler(stream)  # type: ignore[arg-type]


@pytest.mark.usefixtures("few")
async def test_a_peer_has_so_many_connections_until_their_sockets_are_closed() -> None:
    served: list[Stream] = []

    async def serve(stream: Any) -> None:
        served.append(stream)

    handler = AcceptedConnections().bounded(serve)
    first, second, third, other = (
        Stream("/a"),
        Stream("/b"),
        Stream("/a"),
        Stream("/c", b"c" * 32),
    )
    await accept(handler, first, second, third, other)
    assert served == [first, second, other]
    assert third.reasons == ["too many connections of one identity"]
    for call in first.on_closed:
        call()
    await accept(handler, again := Stream("/a"))
    assert served[-1] is again


@pytest.mark.usefixtures("few")
async def test_the_master_may_have_more_connections() -> None:
    async def serve(_: object) -> None: ...

    masters = [Stream("/master") for _ in range(4)]
    await accept(AcceptedConnections().bounded(serve), *masters)
    assert [stream.reasons for stream in masters] == [[]] * 4


async def test_every_connection_of_a_revoked_key_is_closed() -> None:
    async def serve(_: object) -> None: ...

    accepted = AcceptedConnections()
    gone, stays = Stream("/a"), Stream("/b", b"b" * 32)
    await accept(accepted.bounded(serve), gone, stays)
    accepted.abort_revoked(frozenset({KEY}))
    assert (gone.reasons, stays.reasons) == (["the peer's identity is revoked"], [])
    accepted.abort_revoked(frozenset({ABOVE}))
    assert stays.reasons == ["the peer's identity is revoked"]
