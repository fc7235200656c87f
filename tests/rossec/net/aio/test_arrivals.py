"""Messages from a stream on a loop."""

import asyncio

import pytest

from rossec import clock
from rossec.errors import LimitExceeded
from rossec.net.aio import stream
from rossec.net.aio.stream import next_messages
from rossec.ros.tcpros import FrameReader, Framing, frame


class Script:
    """Returns the given bytes, then nothing more."""

    def __init__(self, *units: bytes) -> None:
        self._units = list(units)

    async def receive(self) -> bytes:
        if not self._units:
            await asyncio.Event().wait()
        return self._units.pop(0)


async def test_bytes_are_split_into_messages() -> None:
    source, framing = Script(frame(b"a") + b"\1", frame(b"b")[1:]), Framing(FrameReader())
    assert await next_messages(source, framing) == [b"a"]
    assert await next_messages(source, framing) == [b"b"]


async def test_silence_between_messages_is_allowed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stream, "PATIENCE", 0.0)
    monkeypatch.setattr(clock, "now", lambda: pytest.fail("asked although nothing is begun"))
    with pytest.raises(TimeoutError):
        async with asyncio.timeout(0.05):
            await next_messages(Script(), Framing(FrameReader()))


async def test_silence_within_a_message_ends_the_stream(monkeypatch: pytest.MonkeyPatch) -> None:
    ticks = iter(range(0, 10_000, 5))
    monkeypatch.setattr(stream, "PATIENCE", 0.001)
    monkeypatch.setattr(clock, "now", lambda: next(ticks))
    source, framing = Script(frame(bytes(9))[:6]), Framing(FrameReader())
    assert await next_messages(source, framing) == []
    with pytest.raises(LimitExceeded):
        await next_messages(source, framing)
