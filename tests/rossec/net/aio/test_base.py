"""Received units are taken or forwarded in order; whoever lags is waited for."""

import asyncio
import socket
from collections.abc import AsyncIterator

import pytest

from rossec.channel.records import Bytes
from rossec.errors import ChannelClosed
from rossec.net.aio.transport import BaseStream, Transport


class Fed(BaseStream):
    """A stream whose units come from the test; a byte of its socket is a unit."""

    def __init__(self, sock: socket.socket) -> None:
        super().__init__()
        self.buffer = memoryview(bytearray(1))
        self.transport = Transport(sock, self)
        self.transport.resume_reading()

    def get_buffer(self) -> memoryview:
        return self.buffer

    def buffer_updated(self, count: int) -> None:
        self.arrive(self.buffer[:count])

    def arrive(self, *units: Bytes) -> None:
        for unit in units:
            self._deliver(unit)
        if self.has_unit:
            self._notify()

    def eof_received(self) -> None:
        self.error = ChannelClosed("over")
        self._notify()

    def resume_writing(self) -> None:
        self._wake_waiters()

    def connection_lost(self) -> None:
        self.eof_received()


@pytest.fixture
async def fed() -> AsyncIterator[tuple[Fed, socket.socket]]:
    with socket.create_server(("127.0.0.1", 0)) as server:
        far = socket.create_connection(server.getsockname())
        stream = Fed(server.accept()[0])
    yield stream, far
    far.close()
    stream.transport.abort()


async def test_units_are_received_in_order_and_the_end_after_them(fed: tuple[Fed, socket.socket]) -> None:
    stream, far = fed
    far.sendall(b"12")
    assert await stream.receive() == b"1"
    assert await stream.receive() == b"2"
    stream.arrive(b"last")
    ended = asyncio.ensure_future(stream.wait_ended())
    far.close()
    await ended
    assert stream.next_unit() == b"last"
    for _ in range(2):
        with pytest.raises(ChannelClosed, match="over"):
            await stream.receive()
    with pytest.raises(ChannelClosed):
        await stream.drain()


async def test_reading_pauses_while_units_are_not_taken(fed: tuple[Fed, socket.socket]) -> None:
    stream, _ = fed
    called: list[bool] = []
    stream.on_ready(lambda: called.append(stream.has_unit))
    assert stream.next_unit() is None
    stream.arrive(bytes(600_000), bytes(600_000))
    reading = [stream.transport.reading]
    for _ in range(2):
        assert stream.next_unit() == bytes(600_000)
        reading.append(stream.transport.reading)
    assert (called, reading, stream.has_unit) == ([True], [False, False, True], False)


async def test_a_sink_that_lags_is_drained_before_more_is_read(fed: tuple[Fed, socket.socket]) -> None:
    stream, far = fed
    sink, drained, lagged = bytearray(), asyncio.Event(), asyncio.Event()

    def write_nowait(unit: Bytes) -> bool:
        sink.extend(unit)
        return len(sink) != 2

    async def drain() -> None:
        if len(sink) == 2:
            lagged.set()
            await drained.wait()

    stream.arrive(b"0")
    forwarding = asyncio.ensure_future(stream.forward(write_nowait, drain))
    far.sendall(b"12")
    await lagged.wait()
    assert (bytes(sink), stream.transport.reading) == (b"01", False)
    drained.set()
    far.close()
    with pytest.raises(ChannelClosed):
        await forwarding
    assert sink == b"012"


async def test_what_a_sink_raises_is_raised_by_forward(fed: tuple[Fed, socket.socket]) -> None:
    stream, far = fed

    def write_nowait(_: Bytes) -> bool:
        raise ZeroDivisionError

    far.sendall(b"1")
    with pytest.raises(ZeroDivisionError):
        await stream.forward(write_nowait, stream.drain)


async def test_what_was_written_is_flushed_when_the_kernel_has_taken_all_of_it(
    fed: tuple[Fed, socket.socket],
) -> None:
    stream, far = fed
    await stream.flushed()
    size = 8_000_000
    stream.transport.write(bytes(size))
    assert stream.backlog > 0
    reading = asyncio.ensure_future(asyncio.to_thread(far.recv, size, socket.MSG_WAITALL))
    await stream.flushed()
    assert stream.backlog == 0
    assert len(await reading) == size
    far.close()
    await stream.wait_ended()
    with pytest.raises(ChannelClosed, match="over"):
        await stream.flushed()


async def test_a_writer_waits_until_the_peer_has_read(fed: tuple[Fed, socket.socket]) -> None:
    stream, far = fed
    size = 8_000_000
    stream.transport.write(bytes(size))
    lags = [stream.lags]
    reading = asyncio.ensure_future(asyncio.to_thread(far.recv, size, socket.MSG_WAITALL))
    await stream.drain()
    assert [*lags, stream.lags] == [True, False]
    assert len(await reading) == size
