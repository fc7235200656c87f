"""A plain stream hands on what arrives, holds back when told to, and never loses or mixes bytes."""

import asyncio
import socket

import pytest

from rossec.errors import ChannelClosed
from rossec.sidecar.plain_stream import PlainStream
from tests.support.witness import until


class Sink:
    """Takes what is pushed; lags after each, until it is let go."""

    def __init__(self, *, lags: bool = False) -> None:
        self.got = bytearray()
        self.lags = lags
        self.free = asyncio.Event()
        self.arrived = asyncio.Event()

    def write_nowait(self, data: memoryview) -> bool:
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
async def test_everything_is_forwarded_in_order(lags: bool) -> None:
    near, far = pair()
    sink = Sink(lags=lags)
    forwarding = asyncio.ensure_future(far.forward(sink.write_nowait, sink.drain))
    sending = asyncio.ensure_future(near.send(DATA))
    await sink.arrived.wait()
    if lags:
        await asyncio.wait({sending}, timeout=0.1)
        assert len(sink.got) < len(DATA)
        sink.free.set()
    await sending
    closing = asyncio.ensure_future(near.close())
    with pytest.raises(ChannelClosed):
        await forwarding
    assert sink.got == DATA
    far.abort()
    await closing


async def test_an_error_while_forwarding_fails_the_caller() -> None:
    near, far = pair()

    def fail(_: memoryview) -> bool:
        raise ArithmeticError

    forwarding = asyncio.ensure_future(far.forward(fail, Sink().drain))
    await asyncio.sleep(0)
    await near.send(b"x")
    with pytest.raises(ArithmeticError):
        await forwarding
    for end in (near, far):
        end.abort()


async def test_nothing_is_written_to_a_program_that_is_gone() -> None:
    near, far = pair()
    near.abort()
    with pytest.raises(ChannelClosed):
        near.write_nowait(b"x")
    far.abort()


async def test_units_without_waiting() -> None:
    with socket.create_server(("127.0.0.1", 0)) as near:
        far = socket.create_connection(near.getsockname())
        accepted, _ = near.accept()
    heard = asyncio.Event()
    stream = PlainStream(accepted)
    stream.on_ready(heard.set)
    assert stream.next_unit() is None
    far.sendall(b"ping")
    await heard.wait()
    there = stream.has_unit, stream.next_unit(), stream.has_unit
    assert there == (True, b"ping", False)
    assert stream.try_send(b"pong")
    assert far.recv(4) == b"pong"
    assert stream.try_send(b"x" * 50_000_000)
    assert not stream.try_send(b"more")  # the program lags
    far.close()
    stream.abort()
    await until(lambda: _ended(stream))
    with pytest.raises(ChannelClosed):
        stream.try_send(b"late")


def _ended(stream: PlainStream) -> bool:
    try:
        return stream.next_unit() is not None
    except ChannelClosed:
        return True
