"""A connection and its stream: what is read when, and how each end is passed on."""

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator
from typing import Any, cast

import pytest

from rossec.errors import StreamRefused
from rossec.overlay.streams import Pump
from tests.support.relays import tcp_pair


class FakeEnd:
    """The stream of a pump, with a fixed number, and what the pump told it."""

    def __init__(self) -> None:
        self.buffer: bytearray | None = bytearray(100)
        self.sent = bytearray()
        self.taken = 0
        self.peer_sends = True
        self.events: list[str] = []
        self.changed = asyncio.Event()

    def note(self, event: str) -> None:
        self.events.append(event)
        self.changed.set()

    def buffer_for(self, stream: int) -> memoryview | None:
        assert stream == 7
        self.changed.set()
        return None if self.buffer is None else memoryview(self.buffer)

    def send(self, stream: int, count: int) -> None:
        assert stream == 7
        assert self.buffer is not None
        self.sent += self.buffer[:count]
        self.changed.set()

    def took(self, stream: int, count: int) -> None:
        assert stream == 7
        self.taken += count
        self.changed.set()

    def end(self, stream: int) -> bool:
        assert stream == 7
        self.note("end")
        return self.peer_sends

    def reset(self, stream: int) -> None:
        assert stream == 7
        self.note("reset")


async def wait_for(end: FakeEnd, what: object) -> None:
    assert callable(what)
    async with asyncio.timeout(30):
        while not what():
            end.changed.clear()
            await end.changed.wait()


@contextlib.asynccontextmanager
async def connected() -> AsyncIterator[tuple[Pump, FakeEnd, socket.socket]]:
    end = FakeEnd()
    pump = Pump(7, cast("Any", end))
    mine, theirs = await tcp_pair()
    pump.connect(theirs)
    try:
        with mine:
            yield pump, end, mine
    finally:
        pump.break_off()
        await pump.over.wait()


async def test_bytes_are_read_as_far_as_there_is_room() -> None:
    async with connected() as (pump, end, mine):
        mine.send(bytes(range(250)))
        await wait_for(end, lambda: len(end.sent) == 250)
        assert end.sent == bytes(range(250))
        end.buffer = None
        end.changed.clear()
        mine.send(b"more")
        await end.changed.wait()
        await asyncio.sleep(0.01)
        assert len(end.sent) == 250
        end.buffer = bytearray(3)
        pump.resume()
        assert end.sent[250:] == b"mor"
        await wait_for(end, lambda: end.sent[250:] == b"more")


async def test_what_arrives_is_written_and_counted_as_taken() -> None:
    async with connected() as (pump, end, mine):
        pump.arrived(memoryview(b"hello"))
        assert end.taken == 5
        assert await asyncio.get_running_loop().sock_recv(mine, 10) == b"hello"


async def test_what_a_slow_program_has_not_taken_is_not_counted() -> None:
    async with connected() as (pump, end, mine):
        loop = asyncio.get_running_loop()
        size = 20_000_000
        pump.arrived(bytes(size))
        assert end.taken < size
        got = 0
        while got < size:
            got += len(await loop.sock_recv(mine, 1 << 20))
        await wait_for(end, lambda: end.taken == size)


async def test_bytes_before_there_is_a_socket_are_kept() -> None:
    end = FakeEnd()
    pump = Pump(7, cast("Any", end))
    pump.resume()
    pump.arrived(b"early ")
    pump.arrived(b"bird")
    pump.ended(over=False)
    assert end.taken == 0
    mine, theirs = await tcp_pair()
    with mine:
        before = pump.connected
        pump.connect(theirs)
        assert (before, pump.connected) == (False, True)
        assert end.taken == 10
        loop = asyncio.get_running_loop()
        assert await loop.sock_recv(mine, 100) == b"early bird"
        assert await loop.sock_recv(mine, 100) == b""
        pump.break_off()


async def test_the_first_bytes_decide() -> None:
    pump = Pump(7, cast("Any", FakeEnd()))
    decided = asyncio.ensure_future(pump.first_bytes(lambda first: len(first) if len(first) > 2 else None))
    for part in (b"a", b"b", b"c"):
        await asyncio.sleep(0)
        assert not decided.done()
        pump.arrived(part)
    assert await decided == 3


@pytest.mark.parametrize("broken", [True, False], ids=["broken off", "ended"])
async def test_a_stream_that_ends_before_its_first_bytes(broken: bool) -> None:
    pump = Pump(7, cast("Any", FakeEnd()))

    async def undecided() -> None:
        await pump.first_bytes(lambda _: None)

    deciding = asyncio.ensure_future(undecided())
    await asyncio.sleep(0)
    if broken:
        pump.break_off()
        assert pump.over.is_set()
    else:
        pump.ended(over=False)
    with pytest.raises(StreamRefused, match="before it said anything"):
        await deciding


async def test_an_end_of_the_program_leaves_the_other_direction_open() -> None:
    async with connected() as (pump, end, mine):
        mine.shutdown(socket.SHUT_WR)
        await wait_for(end, lambda: end.events == ["end"])
        pump.resume()
        pump.arrived(b"still")
        pump.ended(over=True)
        loop = asyncio.get_running_loop()
        assert await loop.sock_recv(mine, 10) == b"still"
        assert await loop.sock_recv(mine, 10) == b""
        await pump.over.wait()
        assert end.events == ["end", "reset"]


async def test_the_program_ends_last() -> None:
    async with connected() as (pump, end, mine):
        end.peer_sends = False
        pump.ended(over=False)
        assert await asyncio.get_running_loop().sock_recv(mine, 10) == b""
        mine.close()
        await pump.over.wait()
        assert end.events == ["end", "reset"]


async def test_a_broken_connection_resets_the_stream() -> None:
    async with connected() as (pump, end, mine):
        mine.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\x01\0\0\0\0\0\0\0")
        mine.close()
        await pump.over.wait()
        assert end.events == ["reset"]


async def test_a_stream_that_is_broken_off_resets_the_connection() -> None:
    async with connected() as (pump, end, mine):
        pump.break_off()
        await pump.over.wait()
        pump.break_off()
        with pytest.raises(ConnectionResetError):
            mine.recv(1)
        assert end.events == ["reset"]


async def test_a_socket_that_comes_too_late_is_closed() -> None:
    pump = Pump(7, cast("Any", FakeEnd()))
    pump.break_off()
    mine, theirs = await tcp_pair()
    pump.connect(theirs)
    assert theirs.fileno() == -1
    with mine:
        assert await asyncio.get_running_loop().sock_recv(mine, 1) == b""
