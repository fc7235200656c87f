"""A plain connection that is served without waiting."""

import asyncio
import socket

import pytest

from rossec.errors import ChannelClosed
from rossec.sidecar.plain import PlainStream
from tests.support.witness import until


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
    assert stream.send_at_once(b"pong")
    assert far.recv(4) == b"pong"
    assert stream.send_at_once(b"x" * 50_000_000)
    assert not stream.send_at_once(b"more")  # the program lags
    far.close()
    stream.abort()
    await until(lambda: _ended(stream))
    with pytest.raises(ChannelClosed):
        stream.send_at_once(b"late")


def _ended(stream: PlainStream) -> bool:
    try:
        return stream.next_unit() is not None
    except ChannelClosed:
        return True
