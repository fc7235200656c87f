"""A subscriber with options: thinned out, the newest only, deflated once for all."""

import asyncio
import contextlib
import struct
from collections.abc import AsyncIterator
from types import SimpleNamespace
from typing import Any

import pytest

from rossec.node.publisher import Pieces
from rossec.participant import delivery_options
from rossec.participant.delivery_options import LARGE, DeliveryOptions, DeliveryQueue, deflated
from tests.support.witness import until


class Stream:
    """Collects what is sent; `line` lets what was written leave."""

    def __init__(self) -> None:
        self.sent: list[bytes] = []
        self.line = asyncio.Event()
        self.line.set()
        self.limited = 0
        self.transport = SimpleNamespace(limit_unsent=self._limit)

    def _limit(self) -> None:
        self.limited += 1

    async def send(self, *pieces: bytes) -> None:
        self.sent.append(b"".join(pieces))

    async def flushed(self) -> None:
        await self.line.wait()


@contextlib.asynccontextmanager
async def running(stream: Any, options: DeliveryOptions, size: int = 10) -> AsyncIterator[DeliveryQueue]:
    queue = DeliveryQueue(stream, options, size)
    task = asyncio.ensure_future(queue.run())
    try:
        yield queue
    finally:
        task.cancel()


def framed(content: bytes) -> bytes:
    return struct.pack("<I", len(content)) + content


async def test_the_rate_takes_messages_away(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 0.0
    monkeypatch.setattr(delivery_options, "monotonic", lambda: now)
    stream = Stream()
    async with running(stream, DeliveryOptions(1.0), size=100) as queue:
        for number in range(100):
            now = number * 0.1
            queue.enqueue([b"%d" % number])
        await until(lambda: len(stream.sent) == 11)
    assert stream.sent[:4] == [framed(b"0"), framed(b"1"), framed(b"10"), framed(b"20")]
    assert (queue.thinned, queue.dropped, stream.limited) == (89, 0, 0)


async def test_of_what_waits_only_the_newest_is_sent() -> None:
    stream = Stream()
    stream.line.clear()
    async with running(stream, DeliveryOptions(newest=True), size=100) as queue:
        for number in range(5):
            queue.enqueue([b"%d" % number])
            await asyncio.sleep(0)
        assert stream.sent == []
        stream.line.set()
        await until(lambda: stream.sent)
        assert (stream.sent, queue.dropped, stream.limited) == ([framed(b"4")], 4, 1)
        queue.enqueue([b"5"])
        await until(lambda: len(stream.sent) == 2)


async def test_without_it_the_oldest_comes_first_and_a_full_queue_drops_it() -> None:
    stream = Stream()
    async with running(stream, DeliveryOptions(deflate=True), size=2) as queue:
        queue.enqueue([b"a", b"b"])
        queue.enqueue([b"c"])
        await until(lambda: len(stream.sent) == 2)
    assert stream.sent == [framed(b"\0ab"), framed(b"\0c")]


@pytest.mark.parametrize("size", [10, 3000, LARGE - 1, LARGE, 3 * LARGE])
async def test_messages_are_deflated(size: int) -> None:
    stream = Stream()
    pieces: Pieces = [bytes(size // 2), memoryview(bytes(size - size // 2))]
    async with running(stream, DeliveryOptions(deflate=True)) as queue:
        queue.enqueue(pieces)
        await until(lambda: stream.sent)
    assert stream.sent == [framed(deflated([bytes(size)]))]


async def test_a_message_that_is_replaced_is_never_deflated(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []

    def count(pieces: Any) -> bytes:
        seen.append(b"".join(pieces))
        return deflated(pieces)

    monkeypatch.setattr(delivery_options, "deflated", count)
    stream = Stream()
    stream.line.clear()
    async with running(stream, DeliveryOptions(newest=True, deflate=True)) as queue:
        for number in range(50):
            queue.enqueue([b"%d" % number])
        stream.line.set()
        await until(lambda: stream.sent)
    assert seen == [b"49"]
