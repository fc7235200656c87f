"""Messages that wait for a subscriber are sent together; the oldest give way."""

import asyncio
from typing import Any

from rossec.node.publisher import SubscriberQueue
from tests.support.witness import until


class Stream:
    """Collects what is sent, while it is open."""

    def __init__(self) -> None:
        self.sent: list[bytes] = []
        self.open = asyncio.Event()

    async def send(self, *pieces: bytes) -> None:
        await self.open.wait()
        self.sent.append(b"".join(pieces))


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
