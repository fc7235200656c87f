import asyncio
import time
from types import SimpleNamespace
from typing import Any

import pytest

from ca.errors import RevocationsStale
from ca.revocation.state import Revocations, Timestamp, digest
from rossec import clock
from rossec.clock import Clock
from rossec.participant.revocation_watch import ConnectionWatchdog
from tests.support.site import Site
from tests.support.witness import until


class Connection:
    """A connection that a task still serves after it was aborted."""

    def __init__(self, ends: int) -> None:
        self.aborts: list[str] = []
        peer = SimpleNamespace(name="/eve", keys=(b"k" * 32,))
        self.stream: Any = SimpleNamespace(peer=peer, abort=self.aborts.append)
        self.decision: Any = SimpleNamespace(grant_ids=(), keep_when_stale=False)
        self.ends = ends


@pytest.fixture
def revocations(site: Site) -> Revocations:
    return Revocations(site.anchor.public_key)


async def test_an_expired_connection_is_aborted_once(
    revocations: Revocations,
) -> None:
    connection = Connection(ends=int(time.time()) - 1)
    ports: Any = SimpleNamespace(abort_revoked=lambda _: None)
    checks = 0

    def connections() -> tuple[Connection, ...]:
        nonlocal checks
        checks += 1
        return (connection,)

    async with asyncio.TaskGroup() as group:
        watching = group.create_task(ConnectionWatchdog(revocations, connections, ports).run())
        await until(lambda: connection.aborts)
        for _ in range(1000):
            await asyncio.sleep(0)
        watching.cancel()
    assert len(connection.aborts) == 1
    assert checks < 10, "it waits for the next period"


def test_revocations_are_stale_after_the_clock_was_set_back(
    site: Site, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    shows = time.time()
    monkeypatch.setattr("rossec.clock.HOST", Clock(lambda: shows, lambda: 0.0))
    now, held = int(shows), Revocations(site.anchor.public_key)
    data = site.authority.store.newest_list()
    assert data is not None
    held.update(data, now)
    assert held.current is not None
    timestamp = Timestamp(held.current.seq, digest(data), now, 30)
    held.confirm(timestamp, now)
    ports: Any = SimpleNamespace(abort_revoked=lambda _: None)
    connection = Connection(ends=now + 3600)
    watchdog = ConnectionWatchdog(held, lambda: (connection,), ports)
    watchdog.check(now)
    held.check_fresh(now)
    shows -= 3600
    watchdog.check(clock.now())
    with pytest.raises(RevocationsStale, match="not confirmed"):
        held.check_fresh(clock.now())
    assert connection.aborts == [], "new connections only are refused at once"
    held.confirm(timestamp, now)
    watchdog.check(clock.now())
    held.check_fresh(clock.now())
    assert caplog.text.count("the host's clock went back") == 1
