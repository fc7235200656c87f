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


class Linked:
    """A connection that somebody still serves after it was cut."""

    def __init__(self, ends: int) -> None:
        self.cuts: list[str] = []
        peer = SimpleNamespace(name="/eve", keys=(b"k" * 32,))
        self.stream: Any = SimpleNamespace(peer=peer, abort=self.cuts.append)
        self.decision: Any = SimpleNamespace(grant_ids=(), keep_when_stale=False)
        self.ends = ends


@pytest.fixture
def revocations(site: Site) -> Revocations:
    return Revocations(site.anchor.public_key)


async def test_an_expired_connection_is_aborted_once(
    revocations: Revocations,
) -> None:
    link = Linked(ends=int(time.time()) - 1)
    door: Any = SimpleNamespace(abort_revoked=lambda _: None)
    looks = 0

    def links() -> tuple[Linked, ...]:
        nonlocal looks
        looks += 1
        return (link,)

    async with asyncio.TaskGroup() as group:
        watching = group.create_task(ConnectionWatchdog(revocations, links, door).run())
        await until(lambda: link.cuts)
        for _ in range(1000):
            await asyncio.sleep(0)
        watching.cancel()
    assert len(link.cuts) == 1
    assert looks < 10, "it waits for the next period"


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
    news = Timestamp(held.current.seq, digest(data), now, 30)
    held.confirm(news, now)
    door: Any = SimpleNamespace(abort_revoked=lambda _: None)
    link = Linked(ends=now + 3600)
    watch = ConnectionWatchdog(held, lambda: (link,), door)
    watch.check(now)
    held.check_fresh(now)
    shows -= 3600
    watch.check(clock.now())
    with pytest.raises(RevocationsStale, match="not confirmed"):
        held.check_fresh(clock.now())
    assert link.cuts == [], "only those that come are refused at once"
    held.confirm(news, now)
    watch.check(clock.now())
    held.check_fresh(clock.now())
    assert caplog.text.count("the host's clock went back") == 1
