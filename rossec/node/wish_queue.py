"""The messages for a subscriber with wishes: thinned out, the newest only, deflated.

What comes here has passed the guard. Messages are sent one by one. For the newest to be sent, a
message is taken from the queue only when those before it have left, and is deflated only then.
"""

import asyncio
from collections import deque
from time import monotonic

from ca.certificates import Identity
from rossec.net.aio import SecureStream
from rossec.node.subscriber_queue import LENGTH, Pieces, SubscriberQueue
from rossec.participant.deflating import LARGE, Deflatable, SharedDeflation
from rossec.participant.wished_rate import WishedRate
from rossec.participant.wishes import Wishes


class WishQueue(SubscriberQueue):
    """As `SubscriberQueue`, for a subscriber with `wishes`.

    Attributes:
        thinned: how many messages the rate took away.
    """

    def __init__(
        self,
        stream: SecureStream[Identity],
        queue_size: int,
        wishes: Wishes,
        deflation: SharedDeflation,
    ) -> None:
        super().__init__(stream, 1 if wishes.newest else queue_size)
        self.thinned = 0
        self._wishes = wishes
        self._deflation = deflation
        self._rate = None if wishes.rate is None else WishedRate(wishes.rate)
        self._waiting: deque[Deflatable] = deque()
        if wishes.newest:
            stream.transport.limit_unsent()

    def enqueue(self, pieces: Pieces) -> None:
        """Queue one filtered message, unless the rate takes it away; the oldest gives way."""
        if self._rate is not None and not self._rate.admits(monotonic()):
            self.thinned += 1
            return
        if len(self._waiting) >= self._queue_size:
            self._waiting.popleft()
            self.dropped += 1
        self._waiting.append(self._deflation.of(pieces, pieces))
        self._wake.set()

    async def run(self) -> None:
        """As of `SubscriberQueue`."""
        async with asyncio.TaskGroup() as group:
            group.create_task(self._until_closed())
            while True:
                await self._wake.wait()
                self._wake.clear()
                while self._waiting:
                    await self._send_one()

    async def _send_one(self) -> None:
        if self._wishes.newest:
            await self._stream.flushed()
        message = self._waiting.popleft()
        size = sum(map(len, message.pieces))
        if not self._wishes.deflate:
            await self._stream.send(LENGTH.pack(size), *message.pieces)
            return
        large = size >= LARGE
        content = await asyncio.to_thread(message.content) if large else message.content()
        await self._stream.send(LENGTH.pack(len(content)), content)
