"""Turns of callers: what one of them asks for delays none of the others by more than its turn.

A caller has one turn at a time, and a bounded number of requests that wait for it. Free places go
to those who wait, one caller after the other, however many requests each of them has.
"""

import asyncio
from collections import deque
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from rossec.errors import ServiceFailed


class CallerTurns:
    """Places that callers take in turns.

    Args:
        places: how many callers have a turn at the same time.
        waiting: how many requests of one caller wait; more are refused.
    """

    def __init__(self, places: int, waiting: int) -> None:
        self._free = places
        self._waiting = waiting
        self._having: set[bytes] = set()
        self._queues: dict[bytes, deque[asyncio.Future[None]]] = {}  # in the order of their turns

    @asynccontextmanager
    async def turn(self, caller: bytes) -> AsyncIterator[None]:
        """Wait for a turn of `caller`, and have it.

        Raises:
            ServiceFailed: too many requests of this caller wait already.
        """
        queue = self._queues.setdefault(caller, deque())
        if len(queue) >= self._waiting:
            raise ServiceFailed(f"{self._waiting} requests of yours wait already")
        mine = asyncio.get_running_loop().create_future()
        queue.append(mine)
        self._give()
        try:
            await mine
            yield
        finally:
            self._end(caller, mine)

    def _end(self, caller: bytes, mine: "asyncio.Future[None]") -> None:
        """A turn is over, or nobody waits for it any more."""
        if mine.done() and not mine.cancelled():
            self._free += 1
            self._having.discard(caller)
            if caller in self._queues:
                self._queues[caller] = self._queues.pop(caller)  # behind all others
        else:
            queue = self._queues.get(caller, deque())
            if mine in queue:
                queue.remove(mine)
            if not queue:
                self._queues.pop(caller, None)
        self._give()

    def _give(self) -> None:
        """Give free places to those who wait longest for a turn, one of each caller."""
        for caller in list(self._queues):
            if not self._free:
                return
            if caller in self._having:
                continue
            queue = self._queues.pop(caller)
            while queue and queue[0].cancelled():
                queue.popleft()
            if queue:
                queue.popleft().set_result(None)
                self._free -= 1
                self._having.add(caller)
            if queue:
                self._queues[caller] = queue  # behind all others
