"""How many messages a right admits: a rate, counted exactly, and slots of time. Pure.

A rate hides nothing of when something begins: its first message passes at once. With a slot the time is
divided into slots of so many seconds, at the same moments for everybody. Padding hides from who watches the
network how long a message is (docs/spec/channel.md section 5).
"""

import re
from typing import Final

_SECOND: Final = 10**9
_MICROSECONDS: Final = 10**6
MIN_SLOT: Final = 10
MAX_SLOT: Final = 86_400
MIN_PAD: Final = 32
MAX_PAD: Final = 65_536
_RARE: Final = 0.1  # a second: below it an interval is easier to read
_BODY: Final = re.compile(r"[A-Za-z][A-Za-z0-9_-]{0,63}", re.ASCII)
_LONGEST: Final = 1 << 62  # nanoseconds, 146 years: what any rate may have been meant to be
_PARTS: Final = 30  # messages pass in the first of so many parts of a slot


def is_body(name: str) -> bool:
    """Whether it may name a body in a restriction."""
    return _BODY.fullmatch(name) is not None


def rate_text(rate: float) -> str:
    """A rate as text: `at most 5 messages a second`, `at most one message every 30 s`."""
    if rate < _RARE:
        return f"at most one message every {1 / rate:.3g} s"
    return f"at most {rate:g} message{'' if rate == 1 else 's'} a second"


# A rate of whole seconds and of sums of floats gives less than it says: 0.1 a second came every 11 s, 0.7
# every 2 s. So what a bucket holds is counted in nanoseconds, of a clock read to the microsecond.
class RateBucket:
    """`rate` messages a second, and bursts of at most `max(1, rate)`.

    A message costs `interval`, and the bucket holds time: `left` nanoseconds, up to `capacity`.
    """

    __slots__ = ("_refilled_at", "capacity", "interval", "last_message", "left")

    def __init__(self, rate: float, tokens: float) -> None:
        self.interval: Final = round(min(_SECOND / rate, _LONGEST))
        self.capacity: Final = max(self.interval, _SECOND)
        self.left = min(int(tokens * self.interval), self.capacity)
        self.last_message: object = None
        self._refilled_at: int | None = None

    @property
    def tokens(self) -> float:
        return self.left / self.interval

    def refill(self, now: float) -> bool:
        # Add the time since then, none if the clock was set back; whether a message fits.
        # A time in whole microseconds: floats of seconds since the epoch have a quarter of one.
        moment = round(now * _MICROSECONDS) * 1000
        if self._refilled_at is not None and moment > self._refilled_at:
            self.left = min(self.left + moment - self._refilled_at, self.capacity)
        self._refilled_at = moment
        return self.left >= self.interval

    def charge(self, message_id: object) -> None:
        if self.left >= self.interval:
            self.last_message = message_id
        self.left = max(self.left - self.interval, 0)

    def is_full(self, now: float) -> bool:
        self.refill(now)
        return self.left >= self.capacity


# What begins, ends or happens once is known to a slot, and what happens seldom not at all: a first message
# alone would tell its moment, so the one of the next slot is the first that passes.
class SlotGate:
    """One message in each slot of so many seconds, in its beginning, if the slot before had any."""

    __slots__ = ("_follows", "_noted", "_passed", "_slot", "_used", "seconds")

    def __init__(self, seconds: int) -> None:
        self.seconds: Final = seconds
        self._slot: int | None = None
        self._follows = False
        self._used = False
        self._noted: object = None
        self._passed: object = None

    def note(self, message_id: object, now: float) -> bool:
        # One that is tried again, for a connection that is new, is no other message.
        if message_id is self._noted:
            return message_id is self._passed
        self._noted = message_id
        slot = int(now // self.seconds)
        if slot + 1 == self._slot:  # the clock was set back over the border: what passed, passed
            return message_id is self._passed
        if slot != self._slot:
            self._follows = self._slot is not None and slot == self._slot + 1
            self._slot, self._used = slot, False
        return message_id is self._passed or (self._follows and self._is_open(now))

    def ready(self, now: float) -> bool:
        slot = int(now // self.seconds)
        if slot == self._slot:
            return self._follows and self._is_open(now)
        return slot - 1 == self._slot and self._is_beginning(now)

    def _is_open(self, now: float) -> bool:
        return not self._used and self._is_beginning(now)

    def _is_beginning(self, now: float) -> bool:
        return now % self.seconds * _PARTS < self.seconds

    def charge(self, message_id: object) -> None:
        if message_id is not self._passed:
            self._used, self._passed = True, message_id

    def is_fresh(self, now: float) -> bool:
        return self._slot is None or now // self.seconds > self._slot + 1

    def is_in_use(self, now: float) -> bool:
        return self._slot is not None and abs(now // self.seconds - self._slot) <= 1


class TokenBucket:
    """`rate` tokens a second, at most `capacity` at once; full at first, and the caller takes from `tokens`.

    The clock is the caller's, in seconds since any beginning, but always the same one.
    """

    __slots__ = ("_rate", "_refilled_at", "capacity", "tokens")

    def __init__(self, rate: float, capacity: float, tokens: float | None = None) -> None:
        self.capacity = capacity
        self.tokens = capacity if tokens is None else min(tokens, capacity)
        self._rate = rate
        self._refilled_at: float | None = None

    def refill(self, now: float) -> float:
        """Add the tokens since the last refill; how many there are. A clock set back adds none."""
        if self._refilled_at is not None and now > self._refilled_at:
            self.tokens = min(self.tokens + (now - self._refilled_at) * self._rate, self.capacity)
        self._refilled_at = now
        return self.tokens
