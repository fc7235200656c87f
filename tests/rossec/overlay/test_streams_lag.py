"""Streams on a link that lags, as the routers' links do: turns, and what ends it."""

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator, Callable
from typing import Any, cast

import pytest

from rossec.channel.records import Bytes
from rossec.errors import ChannelError, ConnectionTruncated
from rossec.overlay import streams as module
from rossec.overlay.mux import FIRST, MAX_DATA, MOST, Credit, Data, Role, Unit, data_head, read_units
from rossec.overlay.streams import Streams
from tests.support.relays import ROBOT, tcp_pair


class SlowLink:
    """A link that takes a few units at a time; what it took is in `units`."""

    def __init__(self, at_once: int) -> None:
        self.units: list[bytes] = []
        self.at_once = self.free = at_once
        self.backlog = 0
        self.error: ChannelError | None = None
        self.take: Callable[[bytes], bool] | None = None
        self.drained = asyncio.Event()
        self.wrote = asyncio.Event()

    def on_ready(
        self, callback: Callable[[], None] | None, take: Callable[[bytes], bool] | None = None
    ) -> None:
        self.take = take

    def next_unit(self) -> bytes | None:
        return None

    def write_nowait(self, data: Bytes) -> bool:
        if self.error is not None:
            raise self.error
        self.units.append(bytes(data))
        self.free -= 1
        self.wrote.set()
        return self.free > 0

    async def drain(self) -> None:
        await self.drained.wait()
        self.drained.clear()
        if self.error is not None:
            raise self.error
        self.free = self.at_once

    async def until(self, count: int) -> None:
        async with asyncio.timeout(10):
            while len(self.units) < count:
                self.wrote.clear()
                await self.wrote.wait()

    def abort(self, reason: str) -> None:
        self.backlog = 0

    def streams(self) -> list[int]:
        """Of which streams the units with data are, in order."""
        return [unit.stream for data in self.units for unit in read_units(data) if is_data(unit)]


def is_data(unit: Unit) -> bool:
    return isinstance(unit, Data)


@contextlib.asynccontextmanager
async def on_slow_link(link: SlowLink, count: int) -> AsyncIterator[list[socket.socket]]:
    """That many connections, with more to send than the link takes."""
    streams = Streams(cast("Any", link), Role.CALLER, "hospital")
    running = asyncio.ensure_future(streams.run())
    await asyncio.sleep(0)
    pairs = [await tcp_pair() for _ in range(count)]
    tasks = [running, *(asyncio.ensure_future(streams.carry(ROBOT, far)) for _, far in pairs)]
    await link.until(count)
    link.free = link.at_once
    try:
        yield [near for near, _ in pairs]
    finally:
        for near, _ in pairs:
            near.close()
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def test_connections_wait_their_turn_while_the_link_lags() -> None:
    """One unit fits at a time: each connection is read once before any is read again."""
    link = SlowLink(4)
    async with on_slow_link(link, 3) as programs:
        for program_ in programs:
            program_.send(bytes(3 * MAX_DATA))
        await link.until(3 + 4)
        await asyncio.sleep(0.05)
        assert len(link.streams()) == 4  # nothing more is read
        link.at_once = 1
        for count in range(5, 9):
            link.drained.set()
            await link.until(3 + count)
        last = link.streams()[4:]
        assert all(set(last[at : at + 3]) == {0, 1, 2} for at in (0, 1))


async def test_a_program_that_takes_all_in_a_round_trip_may_be_sent_more() -> None:
    link, now = SlowLink(1000), [100.0]
    loop = asyncio.get_running_loop()
    streams = Streams(
        cast("Any", link), Role.CALLER, "hospital", clock=lambda: now[-1], round_trip=lambda: 0.1
    )
    running = asyncio.ensure_future(streams.run())
    await asyncio.sleep(0)
    near, far = await tcp_pair()
    carrying = asyncio.ensure_future(streams.carry(ROBOT, far))
    await link.until(1)
    assert link.take is not None
    sent = 0
    for _ in range(16):
        link.take(data_head(0, MAX_DATA) + bytes(MAX_DATA))
        sent += MAX_DATA
        got = 0
        while got < MAX_DATA:
            got += len(await loop.sock_recv(near, MAX_DATA))
        now.append(now[-1] + 0.04)
    units = [unit for data in link.units for unit in read_units(data)]
    given = sum(unit.amount for unit in units if isinstance(unit, Credit))
    assert FIRST < given + FIRST - sent <= MOST, "what it may be sent now"
    near.close()
    for task in (carrying, running):
        task.cancel()
    await asyncio.gather(carrying, running, return_exceptions=True)


async def test_a_link_that_ends_while_it_lags() -> None:
    link = SlowLink(2)
    async with on_slow_link(link, 1) as (near,):
        near.send(bytes(3 * MAX_DATA))
        await link.until(1 + 2)
        link.error = ConnectionTruncated("cut")
        link.drained.set()
        with pytest.raises(ConnectionResetError):
            await asyncio.get_running_loop().sock_recv(near, 1)


async def test_a_link_that_ends_when_it_is_written_to() -> None:
    link = SlowLink(100)
    async with on_slow_link(link, 1) as (near,):
        link.error = ConnectionTruncated("cut")
        near.send(b"x")
        with pytest.raises(ConnectionResetError):
            await asyncio.get_running_loop().sock_recv(near, 1)


async def test_small_units_that_nobody_reads_end_the_link(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MOST_UNSENT", 100)
    """The peer sends, and reads none of the credit that it gets for it."""
    link = SlowLink(3)
    async with on_slow_link(link, 2) as (one, _):
        link.free = 1
        one.send(b"x")
        await link.until(3)
        link.backlog = 101
        assert link.take is not None
        link.take(data_head(1, MAX_DATA) + bytes(MAX_DATA))
        assert len(link.units) == 3
        link.take(data_head(1, MAX_DATA) + bytes(MAX_DATA))
        assert len(link.units) == 4
        with pytest.raises(ConnectionResetError):
            await asyncio.get_running_loop().sock_recv(one, 1)
