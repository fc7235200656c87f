"""Sealed echoes at 200 Hz through three routers in a triangle, while the one in use fails."""

import asyncio
import itertools
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path

import pytest

from rossec.overlay.endpoint import LinkListener, dial_link, stats_of
from tests.support.contexts import context
from tests.support.overlay import carrier, until
from tests.support.routerprocess import RouterProcess, home_with
from tests.support.secure_streams import Stream, echo
from tests.support.wire import ALICE, BOB

KEY = "rossec/1/open/" + 32 * "b"
PERIOD = 0.005


@asynccontextmanager
async def triangle(directory: Path) -> AsyncIterator[list[RouterProcess]]:
    """Three open routers, each joined to the others."""
    routers: list[RouterProcess] = []
    for number in range(3):
        join = tuple(each.locator for each in routers)
        routers.append(RouterProcess(home_with(directory / str(number), protocol="tcp", join=join)))
    async with AsyncExitStack() as stack:
        for each in routers:
            stack.push_async_callback(each.stop)
        await asyncio.gather(*(each.start() for each in routers))
        yield routers


class Echoes:
    """Sends at 200 Hz, and notes when answers arrive and how late the loop was."""

    def __init__(self, stream: Stream) -> None:
        self._stream = stream
        self.sent = 0
        self.arrived: list[float] = []
        self.late = 0.0

    async def run(self) -> None:
        async with asyncio.TaskGroup() as group:
            group.create_task(self._send())
            group.create_task(self._receive())

    async def _send(self) -> None:
        loop = asyncio.get_running_loop()
        while True:
            await self._stream.send(self.sent.to_bytes(100))
            self.sent += 1
            due = loop.time() + PERIOD
            await asyncio.sleep(PERIOD)
            self.late = max(self.late, loop.time() - due)

    async def _receive(self) -> None:
        answered = 0
        while True:
            unit = await self._stream.receive()  # what waited for a router may come together
            for begin in range(0, len(unit), 100):
                assert int.from_bytes(unit[begin : begin + 100]) == answered
                answered += 1
            self.arrived.append(asyncio.get_running_loop().time())

    @property
    def longest(self) -> float:
        """The longest time without an answer, in seconds."""
        return max(later - before for before, later in itertools.pairwise(self.arrived))


@pytest.mark.parametrize(("failure", "most"), [("kill", 1.0), ("freeze", 5.0)])
async def test_no_connection_is_lost_when_the_router_in_use_fails(
    tmp_path: Path, failure: str, most: float
) -> None:
    async with triangle(tmp_path) as routers:
        locators = [each.locator for each in routers]
        async with (
            carrier(*locators) as mine,
            carrier(*locators[1:], locators[0]) as theirs,
            LinkListener(theirs, KEY, context(BOB), echo),
        ):
            stream = await dial_link(mine, KEY, "open", context(ALICE))
            echoes = Echoes(stream)
            running = asyncio.get_running_loop().create_task(echoes.run())
            await until(lambda: len(echoes.arrived) > 50)
            (used,) = (each for each in routers if each.locator == mine.router)
            if failure == "kill":
                await used.kill()
            else:
                used.freeze()
            await until(lambda: mine.router not in {"", used.locator})
            count = len(echoes.arrived)
            await until(lambda: len(echoes.arrived) > count + 50)
            assert not running.done()
            assert echoes.longest < most
            assert echoes.late < 0.5  # nobody else in the process waited for the router
            assert stats_of(stream).srtt_s < 1
            running.cancel()
            stream.abort("done")
