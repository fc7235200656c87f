"""The messages that wait for one subscriber.

A full queue drops its oldest message, as rospy's does; what waits is sent together.
"""

import asyncio
import struct
from collections import deque
from collections.abc import Sequence
from typing import Final

from ca.certificates import Identity
from rossec.net.aio import SecureStream

LENGTH: Final = struct.Struct("<I")
# Batching amortizes system calls; beyond this a unit only adds latency (measured optimum 256 KiB).
_BATCH: Final = 256 * 1024

Pieces = Sequence[bytes | bytearray | memoryview]


class SubscriberQueue:
    """The messages for one admitted subscriber."""

    def __init__(self, stream: SecureStream[Identity], queue_size: int) -> None:
        self.withheld = 0
        self._stream = stream
        self.dropped = 0
        self._queue: deque[Pieces] = deque()
        self._queue_size = queue_size
        self._wake = asyncio.Event()

    def enqueue(self, pieces: Pieces) -> None:
        """Queue one filtered message; the oldest is dropped when the queue is full."""
        if len(self._queue) >= self._queue_size:
            self._queue.popleft()
            self.dropped += 1
        self._queue.append(pieces)
        self._wake.set()

    async def run(self) -> None:
        """Send queued messages until the stream ends, which raises."""
        async with asyncio.TaskGroup() as group:
            group.create_task(self._until_closed())
            while True:
                await self._wake.wait()
                self._wake.clear()
                while self._queue:
                    await self._stream.send(*self._next_batch())

    async def _until_closed(self) -> None:
        while True:  # a TCPROS subscriber sends nothing after its header
            await self._stream.receive()

    def _next_batch(self) -> list[bytes | bytearray | memoryview]:
        batch: list[bytes | bytearray | memoryview] = []
        size = 0
        while self._queue and size < _BATCH:
            pieces = self._queue.popleft()
            length = sum(map(len, pieces))
            batch.append(LENGTH.pack(length))
            batch.extend(pieces)
            size += LENGTH.size + length
        return batch
