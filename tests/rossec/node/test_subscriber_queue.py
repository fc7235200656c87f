"""Messages that wait for a subscriber are sent together; the oldest give way."""

import asyncio
from typing import Any

from rossec.node.publisher import Pieces, SubscriberQueue
from tests.support.witness import until


class Stream:
    """Collects what is sent, while it is open."""

    def __init__(self) -> None:
        self.sent: list[bytes] = []
        self.pieces: list[int] = []
        self.open = asyncio.Event()

    async def send(self, *pieces: bytes) -> None:
        await self.open.wait()
        self.sent.append(b"".join(pieces))
        self.pieces.append(len(pieces))


async def test_a_batch_is_bounded() -> None:
    stand_in: Any = Stream()
    queue = SubscriberQueue(stand_in, 100)
    for _ in range(5):
        queue.enqueue([bytes(100_000)])
    stand_in.open.set()
    running = asyncio.ensure_future(queue.run())
    await until(lambda: len(stand_in.sent) == 2)
    running.cancel()
    assert [len(each) for each in stand_in.sent] == [3 * 100_004, 2 * 100_004]


async def test_what_waits_is_sent_together_and_the_oldest_gives_way() -> None:
    stream: Any = Stream()
    queue = SubscriberQueue(stream, 2)
    running = asyncio.ensure_future(queue.run())
    for message in (b"a", b"b", b"c"):
        queue.enqueue([message])
    stream.open.set()
    await until(lambda: stream.sent)
    assert (stream.sent, queue.dropped) == ([b"\1\0\0\0b\1\0\0\0c"], 1)
    running.cancel()


async def test_short_messages_are_one_piece_and_a_large_one_is_not_copied() -> None:
    stream: Any = Stream()
    queue = SubscriberQueue(stream, 100)
    stream.open.set()
    large = bytes(300_000)
    waiting: list[Pieces] = [[b"a", memoryview(b"bc")], [b""], [large]]
    for pieces in waiting:
        queue.enqueue(pieces)
    running = asyncio.ensure_future(queue.run())
    await until(lambda: stream.sent)
    queue.enqueue([b"a", memoryview(b"bc")])
    queue.enqueue([b""])
    await until(lambda: len(stream.sent) == 2)
    running.cancel()
    short = b"\3\0\0\0abc\0\0\0\0"
    assert stream.sent == [short + len(large).to_bytes(4, "little") + large, short]
    assert stream.pieces == [2 * 3 + 1, 1]
