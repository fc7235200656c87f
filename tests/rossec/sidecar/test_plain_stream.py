"""A plain stream forwards bytes in order, with back-pressure, and loses none."""

import asyncio
import socket

import pytest

from rossec.channel.records import Bytes
from rossec.errors import ChannelClosed
from rossec.sidecar.loopback_port import PlainStream
from tests.support.witness import until


class Sink:
    """Records what is written; optionally lags until `free` is set."""

    def __init__(self, *, lags: bool = False) -> None:
        self.got = bytearray()
        self.lags = lags
        self.free = asyncio.Event()
        self.arrived = asyncio.Event()

    def write_nowait(self, data: Bytes) -> bool:
        self.got += data
        self.arrived.set()
        return not self.lags

    async def drain(self) -> None:
        if self.lags and self.got:
            await self.free.wait()


def pair() -> tuple[PlainStream, PlainStream]:
    left, right = _tcp()
    return PlainStream(left), PlainStream(right)


def _tcp() -> tuple[socket.socket, socket.socket]:
    with socket.create_server(("127.0.0.1", 0)) as server:
        left = socket.create_connection(server.getsockname())
        return left, server.accept()[0]


DATA = bytes(range(256)) * 8000


@pytest.mark.parametrize("lags", [False, True])
async def test_forwarding_keeps_the_order(lags: bool) -> None:
    left, right = pair()
    sink = Sink(lags=lags)
    forwarding = asyncio.ensure_future(right.forward(sink.write_nowait, sink.drain))
    sending = asyncio.ensure_future(left.send(DATA))
    await sink.arrived.wait()
    if lags:
        await asyncio.wait({sending}, timeout=0.1)
        assert len(sink.got) < len(DATA)
        sink.free.set()
    await sending
    closing = asyncio.ensure_future(left.close())
    with pytest.raises(ChannelClosed):
        await forwarding
    assert sink.got == DATA
    right.abort()
    await closing


async def test_an_error_while_forwarding_is_raised_by_forward() -> None:
    left, right = pair()

    def fail(_: Bytes) -> bool:
        raise ArithmeticError

    forwarding = asyncio.ensure_future(right.forward(fail, Sink().drain))
    await asyncio.sleep(0)
    await left.send(b"x")
    with pytest.raises(ArithmeticError):
        await forwarding
    for end in (left, right):
        end.abort()


async def test_writing_to_a_closed_connection_fails() -> None:
    left, right = pair()
    left.abort()
    with pytest.raises(ChannelClosed):
        left.write_nowait(b"x")
    right.abort()


async def test_units_are_read_and_sent_without_waiting() -> None:
    with socket.create_server(("127.0.0.1", 0)) as left:
        right = socket.create_connection(left.getsockname())
        accepted, _ = left.accept()
    received = asyncio.Event()
    stream = PlainStream(accepted)
    stream.on_ready(received.set)
    assert stream.next_unit() is None
    right.sendall(b"ping")
    await received.wait()
    there = stream.has_unit, stream.next_unit(), stream.has_unit
    assert there == (True, b"ping", False)
    assert stream.write_nowait(b"pong")
    assert right.recv(4) == b"pong"
    assert not stream.write_nowait(b"x" * 50_000_000)
    assert stream.lags
    right.close()
    stream.abort()
    await until(lambda: _ended(stream))
    with pytest.raises(ChannelClosed):
        stream.write_nowait(b"late")


def _ended(stream: PlainStream) -> bool:
    try:
        return stream.next_unit() is not None
    except ChannelClosed:
        return True
