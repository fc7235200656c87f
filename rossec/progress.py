"""How long a peer may take for what it has begun: it may be slow, but must get on. Pure.

What is begun is kept until it is whole: a peer that may send much could have that held for ever.
So it has to grow by `LEAST` bytes in each `WINDOW` seconds, and to be whole after `LONGEST`. Only
time in which this side reads counts: between two looks never more than `STEP`, however long the
reader was elsewhere, and whatever becomes of the clock.
"""

from typing import Final

from rossec.errors import LimitExceeded

STEP: Final = 5  # seconds after which to look again
WINDOW: Final = 60
LEAST: Final = 256 * 1024  # 35 kbit/s
LONGEST: Final = 600


class Progress:
    """One thing that arrives in parts, and then the next one."""

    __slots__ = ("_age", "_at", "_mark_age", "_mark_length")

    def __init__(self) -> None:
        self._at: int | None = None
        self._age = self._mark_age = self._mark_length = 0

    @property
    def deadline(self) -> int | None:
        """When to look at the latest; None: nothing is begun."""
        return None if self._at is None else self._at + STEP

    def done(self) -> None:
        """It is whole; what follows is another."""
        self._at = None

    def look(self, now: int, length: int, *, reading: bool = True) -> None:
        """There are `length` bytes of it at `now` (seconds).

        Raises:
            LimitExceeded: it takes too long.
        """
        if self._at is None:
            self._age = self._mark_age = self._mark_length = 0
        elif reading:
            self._age += min(max(0, now - self._at), STEP)
        self._at = now
        if length - self._mark_length >= LEAST:
            self._mark_age, self._mark_length = self._age, length
        if self._age - self._mark_age >= WINDOW or self._age >= LONGEST:
            raise LimitExceeded(
                f"a message is not whole after {self._age} seconds, with {length} bytes of it",
                f"a message must arrive within {LONGEST} s, {LEAST // 1024} KiB of it a minute",
            )
