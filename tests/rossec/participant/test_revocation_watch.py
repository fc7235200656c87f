import asyncio
import time
from types import SimpleNamespace
from typing import Any

import pytest

from ca.errors import RevocationsStale
from ca.revocation.lists import Timestamp, digest
from ca.revocation.trust_status import Revocations
from rossec import clock
from rossec.clock import Clock
from rossec.participant.connections import ConnectionWatchdog
from tests.support.site import Site
from tests.support.witness import until


class Connections:
    """A table with one connection, which is cut when it expires."""

    def __init__(self, ends: float) -> None:
        self.next_expiry: float | None = ends
        self.checks = 0

    def cut_ended(self, now: int) -> None:
        self.checks += 1
        if self.next_expiry is not None and now >= self.next_expiry:
            self.next_expiry = None


@pytest.mark.parametrize("left", [-1, 0.3])
async def test_an_expired_connection_is_cut_at_once(left: float) -> None:
    connections: Any = Connections(time.time() + left)
    connections.next_expiry = int(connections.next_expiry)
    async with asyncio.TaskGroup() as group:
        watching = group.create_task(ConnectionWatchdog(connections, lambda _: None).run())
        await until(lambda: connections.next_expiry is None)
        for _ in range(1000):
            await asyncio.sleep(0)
        watching.cancel()
    assert connections.checks < 10, "it waits for the next period"


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
    connections: Any = SimpleNamespace(cut_ended=lambda _: None)
    watchdog = ConnectionWatchdog(connections, held.expire_confirmation)
    watchdog.check(now)
    held.check_fresh(now)
    shows -= 3600
    watchdog.check(clock.now())
    with pytest.raises(RevocationsStale, match="not confirmed"):
        held.check_fresh(clock.now())
    held.confirm(timestamp, now)
    watchdog.check(clock.now())
    held.check_fresh(clock.now())
    assert caplog.text.count("the host's clock went back") == 1
