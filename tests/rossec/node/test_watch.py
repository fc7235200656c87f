import asyncio
import time
from types import SimpleNamespace
from typing import Any

import pytest

from ca.revocation import Revocations
from rossec.node.watch import Watch
from tests.support.site import Site
from tests.support.witness import until


class Linked:
    """A connection that somebody still serves after it was cut."""

    def __init__(self, ends: int) -> None:
        self.cuts: list[str] = []
        peer = SimpleNamespace(name="/eve", keys=(b"k" * 32,))
        self.stream: Any = SimpleNamespace(peer=peer, abort=self.cuts.append)
        self.decision: Any = SimpleNamespace(grant_ids=())
        self.ends = ends


@pytest.fixture
def revocations(site: Site) -> Revocations:
    return Revocations(site.anchor.public_key)


async def test_an_expired_link_is_cut_once_however_long_it_lingers(
    revocations: Revocations,
) -> None:
    link = Linked(ends=int(time.time()) - 1)
    door: Any = SimpleNamespace(cut=lambda _: None)
    looks = 0

    def links() -> tuple[Linked, ...]:
        nonlocal looks
        looks += 1
        return (link,)

    async with asyncio.TaskGroup() as group:
        watching = group.create_task(Watch(revocations, links, door).run())
        await until(lambda: link.cuts)
        for _ in range(1000):
            await asyncio.sleep(0)
        watching.cancel()
    assert len(link.cuts) == 1
    assert looks < 10, "it waits for the next period"
