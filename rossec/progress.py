"""How long a peer may take to complete a message: it may be slow, but must make progress. Pure.

An incomplete message is kept in memory: a peer that may send much could have it held for ever. So
it has to grow by `MIN_BYTES` in each `WINDOW` seconds, and to be complete after `MAX_SECONDS`. Only
time in which this side reads counts: between two checks never more than `STEP`, however long the
reader was busy, and even if the clock is set.
"""

from typing import Final

from rossec.errors import LimitExceeded

STEP: Final = 5  # seconds until the next check
WINDOW: Final = 60
MIN_BYTES: Final = 256 * 1024  # 35 kbit/s
MAX_SECONDS: Final = 600


class Progress:
    """The progress of one message after the other."""

    __slots__ = ("_age", "_at", "_mark_age", "_mark_length")

    def __init__(self) -> None:
        self._at: int | None = None
        self._age = self._mark_age = self._mark_length = 0

    @property
    def deadline(self) -> int | None:
        """When to check at the latest; None: no message is incomplete."""
        return None if self._at is None else self._at + STEP

    def done(self) -> None:
        """The message is complete; the next bytes belong to another one."""
        self._at = None

    def check(self, now: int, length: int, *, reading: bool = True) -> None:
        """The message has `length` bytes at `now` (seconds).

        Raises:
            LimitExceeded: it takes too long.
        """
        if self._at is None:
            self._age = self._mark_age = self._mark_length = 0
        elif reading:
            self._age += min(max(0, now - self._at), STEP)
        self._at = now
        if length - self._mark_length >= MIN_BYTES:
            self._mark_age, self._mark_length = self._age, length
        if self._age - self._mark_age >= WINDOW or self._age >= MAX_SECONDS:
            raise LimitExceeded(
                f"a message is not whole after {self._age} seconds, with {length} bytes of it",
                f"a message must arrive within {MAX_SECONDS} s,"
                f" {MIN_BYTES // 1024} KiB of it a minute",
            )
