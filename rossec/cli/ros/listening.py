"""A topic of any type as a command listens to it: messages as bytes, and why there are none.

A person who waits is told after a moment: that nobody publishes, or what each publisher was refused
for. Each reason is said once.
"""

import asyncio
from collections import deque
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from typing import Final

from ca.domains.aliases import local_name, shown
from rossec.cli.shared.context import Environment
from rossec.cli.shared.master import node_as
from rossec.node import Node
from rossec.node.raw_subscriber import RawSource
from rossec.node.subscriber import Subscriber
from rossec.terminal import note, printable

MOMENT: Final = 2.0  # seconds in which a publisher that runs is connected
KEPT: Final = 100  # messages that wait; older ones are dropped, as a subscriber's queue does

Arrived = tuple[RawSource, bytes]


class Arrivals:
    """The receiver of a raw subscription: keeps what came, and says what was refused."""

    def __init__(self, size: int = KEPT) -> None:
        self._queue: deque[Arrived] = deque(maxlen=size)
        self._wake = asyncio.Event()
        self._said: set[str] = set()

    def connected(self, _: RawSource) -> None:
        """Nothing is to be said of a publisher that is connected."""

    def received(self, source: RawSource, messages: Sequence[bytes]) -> None:
        """Keep what came; its bytes are of a buffer that is used again."""
        self._queue.extend((source, bytes(message)) for message in messages)
        self._wake.set()

    def disconnected(self, _: RawSource) -> None:
        """Nothing is to be said of a publisher that has gone."""

    def refused(self, error: Exception) -> None:
        """Say once why a publisher is not connected, or no longer."""
        hint = getattr(error, "hint", "")
        text = printable(f"{error}" + (f"; {hint}" if hint else ""))
        if text not in self._said:
            self._said.add(text)
            note(text)

    async def messages(self) -> AsyncIterator[Arrived]:
        """What arrives, for ever."""
        while True:
            while self._queue:
                yield self._queue.popleft()
            self._wake.clear()
            await self._wake.wait()


@asynccontextmanager
async def listening(
    environment: Environment, name: str, node: str
) -> AsyncIterator[tuple[Node, Arrivals]]:
    """A running node that subscribes to the topic, and what arrives there."""
    async with node_as(environment, node) as running:
        arrivals = Arrivals()
        topic = running.settings.resolve(local_name(name))
        subscriber = await running.topics.subscribe_raw(topic, arrivals)
        async with watched(subscriber):
            yield running, arrivals


@asynccontextmanager
async def watched(subscriber: Subscriber) -> AsyncIterator[None]:
    """Say it if nobody publishes after a moment."""
    task = asyncio.ensure_future(_say_if_nobody(subscriber))
    try:
        yield
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


async def _say_if_nobody(subscriber: Subscriber) -> None:
    await asyncio.sleep(MOMENT)
    if not subscriber.publishers:
        note(f"nobody publishes {shown(subscriber.topic)} at this master; waiting")
