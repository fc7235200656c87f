"""What a subscriber's wishes mean for the messages it receives from one publisher.

Inflates what the publisher deflates, never much in one turn of the loop. An older publisher takes
no wish: then messages are thinned out here, which spares the program and not the line.
"""

import asyncio
from collections.abc import Mapping
from time import monotonic

from rossec.participant.deflating import LARGE, claimed_size, inflated
from rossec.participant.wished_rate import WishedRate
from rossec.participant.wishes import Wishes, taken_wishes


class WishedMessages:
    """The messages of one connection that was asked for with wishes.

    Args:
        limit: how long a message may be, in bytes.
    """

    def __init__(self, asked: Wishes, taken: Wishes, limit: int) -> None:
        thins = asked.rate is not None and taken.rate is None
        self._rate = WishedRate(asked.rate) if asked.rate is not None and thins else None
        self._deflated = taken.deflate
        self._limit = limit
        self._this_turn = 0  # bytes inflated since the loop had its turn

    async def inflated(self, content: bytes) -> bytes:
        """The message of a frame; a large one is inflated in another thread.

        Raises:
            FrameRefused: as `rossec.participant.deflating.inflated`.
        """
        if not self._deflated:
            return content
        size = claimed_size(content, self._limit)
        if size >= LARGE:
            return await asyncio.to_thread(inflated, content, self._limit)
        self._this_turn += size
        if self._this_turn >= LARGE:  # thousands of small bombs fit into one unit
            self._this_turn = 0
            await asyncio.sleep(0)
        return inflated(content, self._limit)

    def admits(self) -> bool:
        """Whether the program gets a message now: the publisher sends more than it should."""
        return self._rate is None or self._rate.admits(monotonic())


def wished_messages(
    asked: Wishes, answer: Mapping[str, bytes], limit: int
) -> WishedMessages | None:
    """For a publisher with this answer; None: its messages come as they do without wishes.

    Raises:
        ConnectionHeaderRefused: it answers what was not asked.
    """
    taken = taken_wishes(answer, asked)
    if taken.deflate or taken.rate != asked.rate:
        return WishedMessages(asked, taken, limit)
    return None
