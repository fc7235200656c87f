"""The messages of a stream on a loop, each of which must make progress."""

import asyncio
from collections.abc import Awaitable
from typing import Protocol

from rossec import clock
from rossec.ros.framing import PATIENCE, Framing


class UnitSource(Protocol):
    """Where the bytes come from."""

    def receive(self) -> Awaitable[bytes]:
        """The next bytes."""


async def next_messages(source: UnitSource, framing: Framing) -> list[bytes]:
    """The messages that the next bytes complete, possibly none.

    Raises:
        ChannelError: there are no more; or as of `Framing`.
    """
    while framing.incomplete:
        try:
            async with asyncio.timeout(PATIENCE):
                data = await source.receive()
        except TimeoutError:
            framing.check_progress(clock.now())
        else:
            return framing.feed(data, clock.now())
    return framing.feed(await source.receive(), clock.now())
