"""Messages of a latching publisher, thinned out so that the last one is delivered nevertheless.

A sender that thins out by a wish of a rate (docs/decisions/0036) drops what is too much. Of a topic
whose last message is its value it may drop the very last. So a gateway asks for no rate there, and
holds back by itself: the newest that is too early is due as soon as the rate admits it. Pure.
"""


class Thinning:
    """Messages of one publisher, at most `rate` a second; times are of a monotonic clock."""

    def __init__(self, rate: float) -> None:
        self._interval = 1 / rate
        self._next = float("-inf")
        self._held: bytes | None = None

    @property
    def due(self) -> float | None:
        """When a message that is held back may go; None: there is none."""
        return None if self._held is None else self._next

    def take(self, message: bytes, now: float) -> bytes | None:
        """The message, if it may go now; else it is held back in place of an older one."""
        self._held = message
        return self.release(now)

    def release(self, now: float) -> bytes | None:
        """What was held back, if it may go now."""
        if self._held is None or now < self._next:
            return None
        message, self._held, self._next = self._held, None, now + self._interval
        return message
