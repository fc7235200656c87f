"""The table of connections: limits, what ends a connection, and what arrives meanwhile."""

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import nullcontext, suppress
from dataclasses import replace
from pathlib import Path
from threading import Event, RLock, Thread
from types import SimpleNamespace
from typing import Any

import pytest

from ca.revocation.lists import Timestamp, digest
from ca.revocation.trust_status import Revocations, TrustStatus
from rossec.clock import Clock
from rossec.errors import ChannelClosed, LimitExceeded
from rossec.participant.authorized import STALE_GRACE, AuthorizedConnection
from rossec.participant.connections import UNSHOWN_CONNECTIONS, ConnectionTable
from tests.support.domains import alone
from tests.support.site import Site

NOW = int(time.time())
GRANT = b"g" * 16
KEY, ABOVE = b"k" * 32, b"i" * 32


class FakeStream:
    def __init__(self, name: str = "/viewer", ends: int = NOW + 1000) -> None:
        self.reasons: list[str] = []
        self.events: list[str] = []  # in their order, also those of other streams, if they share it
        self.peer: Any = SimpleNamespace(
            name=name, keys=(KEY, ABOVE), not_after=ends, domain="home", is_foreign=False
        )
        self.on_closed: Callable[[], None] = lambda: None
        self.pad_units: Callable[[int], None] = lambda _: None

    def disconnect(self) -> None:
        self.events.append(f"{self.peer.name} disconnected")

    def abort(self, reason: str) -> None:
        self.events.append(f"{self.peer.name} aborted")
        self.reasons.append(reason)

    def when_closed(self, callback: Callable[[], None]) -> None:
        self.on_closed = callback


Connection = AuthorizedConnection[FakeStream, None]


def make_connection(ends: int = NOW + 1000, keep: bool = False) -> Connection:
    decision: Any = SimpleNamespace(
        grant_ids=(GRANT,), grants=(), keep_when_stale=keep, expires=ends, name="/word", pad=0
    )
    return AuthorizedConnection(FakeStream(ends=max(ends, NOW + 1000)), decision, None)


@pytest.fixture(autouse=True)
def _clock(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rossec.clock.HOST", Clock(lambda: NOW))


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


def trust_status(site: Site) -> TrustStatus:
    return alone(site.anchor, revocations(site))


def test_a_valid_connection_stays_open(site: Site) -> None:
    assert make_connection().termination_reason(trust_status(site), NOW) is None


@pytest.mark.parametrize("late", [0, 1])
def test_a_connection_is_closed_in_the_second_it_expires(site: Site, late: int) -> None:
    assert make_connection(ends=NOW).termination_reason(trust_status(site), NOW - 1) is None
    reason = make_connection(ends=NOW).termination_reason(trust_status(site), NOW + late)
    assert reason == "its grant or its certificate has expired"


@pytest.mark.parametrize("entry", [GRANT, KEY, ABOVE])
def test_a_revoked_grant_or_key_closes_the_connection(site: Site, entry: bytes) -> None:
    site.authority.revoke(entry, "", NOW)
    assert make_connection().termination_reason(trust_status(site), NOW) == f"{entry.hex()} is revoked"


def test_a_connection_outlives_stale_revocations_for_the_grace_period(site: Site) -> None:
    held = trust_status(site)
    last = held.own.fresh_until + STALE_GRACE
    assert make_connection().termination_reason(held, last - 1) is None
    assert "the last confirmation expired" in (make_connection().termination_reason(held, last) or "")


def test_a_connection_is_closed_without_a_revocation_list(site: Site) -> None:
    never = alone(site.anchor, Revocations(site.anchor.public_key))
    assert make_connection().termination_reason(never, NOW) is not None


def test_a_connection_with_on_stale_keep_ends_by_revocation_or_expiry_only(site: Site) -> None:
    never = alone(site.anchor, Revocations(site.anchor.public_key))
    held = trust_status(site)
    long_after = held.own.fresh_until + 10 * STALE_GRACE
    assert make_connection(keep=True).termination_reason(never, NOW) is None
    assert make_connection(ends=long_after + 1, keep=True).termination_reason(held, long_after) is None
    assert make_connection(keep=True).termination_reason(held, NOW + 1000) is not None
    site.authority.revoke(GRANT, "", NOW)
    assert make_connection(ends=long_after + 1, keep=True).termination_reason(
        trust_status(site), long_after
    ) == (f"{GRANT.hex()} is revoked")


def test_a_revoked_grant_closes_the_connection_during_the_grace_period(site: Site) -> None:
    site.authority.revoke(GRANT, "", NOW)
    held = trust_status(site)
    assert make_connection().termination_reason(held, held.own.fresh_until + 1) == f"{GRANT.hex()} is revoked"


def table(held: TrustStatus, lock: Any = None, most: int = 2) -> ConnectionTable[FakeStream]:
    return ConnectionTable(held, lock or nullcontext(), most)


def test_a_connection_is_in_the_table_while_the_block_runs(site: Site) -> None:
    connections, connection = table(trust_status(site)), make_connection()
    with connections.track(connection):
        assert list(connections) == [connection]
        assert connections.next_expiry == connection.ends == NOW + 1000
    assert list(connections) == []
    assert not connections.discard(connection)
    assert connection.stream.reasons == []


def test_an_empty_table_has_no_expiry(site: Site) -> None:
    assert table(trust_status(site)).next_expiry is None


def test_a_connection_that_must_end_is_not_added(site: Site) -> None:
    connections, connection = table(trust_status(site)), make_connection(ends=NOW - 1)
    with pytest.raises(ChannelClosed, match="has expired"), connections.track(connection):
        pytest.fail("it began")
    assert list(connections) == []
    assert connection.stream.reasons == ["its grant or its certificate has expired"]


class ListChanges:
    """A lock of revocations: another thread takes a new list before it is acquired first."""

    def __init__(self, site: Site, held: Revocations) -> None:
        self._site, self._held = site, held
        self.on_changed: Callable[[], None] = lambda: None

    def __enter__(self) -> None:
        if not self._held.entries:
            self._held.update(self._site.revoke(KEY), NOW)
            self.on_changed()

    def __exit__(self, *_: object) -> None:
        pass


@pytest.mark.parametrize("cut_first", [True, False])
def test_a_revocation_during_the_admission_cuts_the_connection(site: Site, cut_first: bool) -> None:
    """The list changes when the connection is in the table, and not checked yet."""
    held = trust_status(site)
    lock = ListChanges(site, held.own)
    connections, connection = table(held, lock), make_connection()
    if cut_first:
        lock.on_changed = lambda: connections.cut_ended(NOW)
    with pytest.raises(ChannelClosed, match="is revoked"):
        connections.add(connection)
    assert set(connection.stream.reasons) == {f"{KEY.hex()} is revoked"}
    assert list(connections) == []


def test_no_connection_of_another_thread_outlives_a_revocation(site: Site) -> None:
    held, lock = revocations(site), RLock()
    connections = table(alone(site.anchor, held), lock)
    admitted: list[Connection] = []
    revoked = Event()

    def admit() -> None:
        with suppress(ChannelClosed):
            while not revoked.is_set():
                connection = make_connection()
                admitted.append(connection)
                connections.add(connection)

    threads = [Thread(target=admit) for _ in range(4)]
    for thread in threads:
        thread.start()
    data = site.revoke(KEY)
    with lock:
        held.update(data, NOW)
    connections.cut_ended(NOW)
    revoked.set()
    for thread in threads:
        thread.join()
    assert admitted
    assert all(connection.stream.reasons for connection in admitted)
    assert list(connections) == []


def test_what_must_end_is_cut_once(site: Site, caplog: pytest.LogCaptureFixture) -> None:
    held = trust_status(site)
    connections = table(held)
    expired, valid = make_connection(ends=NOW + 5), make_connection()
    connections.add(expired)
    connections.add(valid)
    for _ in range(2):
        connections.cut_ended(NOW + 5)
    reason = "its grant or its certificate has expired"
    assert expired.stream.reasons == [reason]
    assert caplog.messages == [f"closed the connection with /viewer (/word): {reason}"]
    assert list(connections) == [valid]


def test_a_closed_table_admits_nothing(site: Site) -> None:
    connections = table(trust_status(site))
    before, after = make_connection(), make_connection()
    connections.add(before)
    connections.close("a task failed")
    with pytest.raises(ChannelClosed, match="a task failed"):
        connections.add(after)
    assert before.stream.reasons == after.stream.reasons == ["a task failed"]
    assert list(connections) == []


def test_the_connections_of_one_peer_are_limited(site: Site) -> None:
    connections = table(trust_status(site))
    eve, other = site.identity("/eve"), site.identity("/other")
    streams: list[FakeStream] = []
    for peer in (eve, other, "10.0.0.1", "10.0.0.2"):
        of_peer = [FakeStream() for _ in range(3)]
        streams += of_peer
        for stream in of_peer[:2]:
            connections.accept(stream, peer)
        name = peer if isinstance(peer, str) else peer.name
        with pytest.raises(LimitExceeded, match=f"{name} has 2 connections already"):
            connections.accept(of_peer[2], peer)
        for _ in range(2):
            connections.forget(of_peer[0])
        connections.accept(of_peer[2], peer)
    for stream in streams:
        connections.forget(stream)
    assert not connections._by_source, "who has gone leaves nothing"


def test_a_grant_counts_as_shown_while_its_connection_is_there(site: Site) -> None:
    """Beside it a peer may have more than the number without a grant."""
    connections, made = table(trust_status(site), most=1000), make_connection()
    eve = made.stream.peer = site.identity("/eve")
    connections.accept(made.stream, eve)
    for _ in range(2):
        connections.add(made)
        connections.discard(made)
    unshown = [FakeStream() for _ in range(UNSHOWN_CONNECTIONS)]
    for stream in unshown:
        connections.accept(stream, eve)
    connections.forget(made.stream)
    with pytest.raises(LimitExceeded, match="connections without a grant"):
        connections.accept(FakeStream(), eve)
    for stream in unshown:
        connections.forget(stream)
    assert not connections._by_source
    assert not connections._shown_by_source


def test_every_connection_of_a_revoked_identity_is_cut(site: Site) -> None:
    """For whatever purpose it was accepted; plain peers have no identity."""
    held = trust_status(site)
    connections = table(held, most=3)
    eve = replace(site.identity("/eve"), issuers=(ABOVE,))
    of_eve, other, plain = FakeStream(), FakeStream(), FakeStream()
    connections.accept(of_eve, eve)
    connections.accept(other, site.identity("/other"))
    connections.accept(plain, "10.0.0.1")
    connections.cut_ended(NOW)
    assert of_eve.events == []
    held.own.update(site.revoke(ABOVE), NOW)
    connections.cut_ended(NOW)
    assert of_eve.reasons == ["the peer's identity is revoked"]
    assert other.events == plain.events == []


class Said(logging.Handler):
    def __init__(self, events: list[str]) -> None:
        super().__init__()
        self._events = events

    def emit(self, record: logging.LogRecord) -> None:
        self._events.append("logged")


@pytest.fixture
def events() -> Iterator[list[str]]:
    """What happens to connections, and what is logged, in one order."""
    found: list[str] = []
    handler, log = Said(found), logging.getLogger("rossec.node")
    log.addHandler(handler)
    yield found
    log.removeHandler(handler)


def opened(
    connections: ConnectionTable[FakeStream], events: list[str], name: str, **given: Any
) -> Connection:
    made = make_connection(**given)
    made.stream.events, made.stream.peer.name = events, name
    connections.add(made)
    return made


@pytest.mark.attack("revocation-at-scale")
def test_all_are_disconnected_before_a_word_is_said_of_one(site: Site, events: list[str]) -> None:
    held = trust_status(site)
    connections = table(held, most=9)
    for number in range(5):
        opened(connections, events, f"/viewer{number}")
    caller = FakeStream("/caller")
    caller.events, eve = events, replace(site.identity("/eve"), issuers=(ABOVE,))
    connections.accept(caller, eve)
    held.own.update(site.revoke(ABOVE), NOW)
    connections.cut_ended(NOW)
    assert {each.split()[-1] for each in events[:6]} == {"disconnected"}
    assert {each.split()[-1] for each in events[6:12]} == {"aborted"}
    assert events[12:] == ["logged"] * 5


@pytest.mark.attack("revocation-at-scale")
def test_whom_the_list_names_is_cut_before_others_are_judged(site: Site, events: list[str]) -> None:
    held = trust_status(site)
    connections = table(held)
    for number in range(20):
        opened(connections, events, f"/old{number}", ends=NOW + 5)
    revoked = opened(connections, events, "/eve")
    revoked.stream.peer.keys = (KEY, b"e" * 32)
    revoked.update_end()
    held.own.update(site.revoke(b"e" * 32), NOW)
    connections.cut_ended(NOW + 5)
    assert events[0] == "/eve disconnected"
    assert len([each for each in events if each.endswith("disconnected")]) == 21


@pytest.mark.attack("revocation-at-scale")
def test_who_presented_something_keeps_no_other_open_while_it_is_judged(
    site: Site, events: list[str]
) -> None:
    held = trust_status(site)
    connections = table(held)
    for number in range(6):
        made = opened(connections, events, f"/viewer{number}")
        made.presented.by_peer = b"renewed" if number % 2 else b""
    judged: list[int] = []

    def continues(connection: Connection, _: int) -> bool:
        if connection.presented.by_peer:
            judged.append(len(events))
        return False

    connections.renewed = SimpleNamespace(continues=continues, retry=lambda *_: None)  # type: ignore[assignment]
    held.own.update(site.revoke(KEY), NOW)
    connections.cut_ended(NOW)
    assert judged == [3, 4, 5]


@pytest.mark.attack("revocation-at-scale")
def test_what_was_disconnected_is_aborted_whatever_happens_to_the_next(site: Site, events: list[str]) -> None:
    held = trust_status(site)
    connections = table(held)
    opened(connections, events, "/eve")
    broken = opened(connections, events, "/other")
    broken.presented.by_peer = b"renewed"  # judged last

    def continues(connection: Connection, _: int) -> bool:
        if connection is broken:
            raise RuntimeError("a bug")
        return False

    connections.renewed = SimpleNamespace(continues=continues, retry=lambda *_: None)  # type: ignore[assignment]
    held.own.update(site.revoke(KEY), NOW)
    with pytest.raises(RuntimeError, match="a bug"):
        connections.cut_ended(NOW)
    assert events == ["/eve disconnected", "/eve aborted"]


def test_a_table_that_is_closed_disconnects_all_first(site: Site, events: list[str]) -> None:
    connections = table(trust_status(site))
    for number in range(3):
        opened(connections, events, f"/viewer{number}")
    connections.close("a task failed")
    assert {each.split()[-1] for each in events[:3]} == {"disconnected"}


@pytest.mark.parametrize("name", ["/viewer", "/master"])
async def test_accepted_streams_are_served_within_the_limit(
    site: Site, name: str, caplog: pytest.LogCaptureFixture
) -> None:
    """The master may have more; a connection counts until its socket is closed."""
    connections = table(trust_status(site))
    peer, served = site.identity(name), []

    async def handler(stream: Any) -> None:
        served.append(stream)

    streams: list[Any] = [FakeStream(name) for _ in range(4)]
    for stream in streams:
        stream.peer = peer
    for stream in streams[:3]:
        await connections.bounded(handler)(stream)
    if name == "/master":
        assert served == streams[:3]
        return
    assert served == streams[:2]
    assert streams[2].reasons == ["too many connections of one identity"]
    assert caplog.messages == ["/viewer has too many connections"]
    streams[0].on_closed()
    await connections.bounded(handler)(streams[3])
    assert served[2:] == [streams[3]]
