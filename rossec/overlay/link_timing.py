"""Round trips of a link, how much may be on the way, and when an answer is overdue. Pure.

The congestion window doubles each round trip until something is lost, then grows by 64 KiB; a loss
halves it, once for all that was on the way then. Routers drop what they cannot queue. A round trip
that became long by what stands in queues shrinks it too: a full uplink loses nothing for seconds.
"""

from math import inf
from typing import Final

FIRST_WINDOW: Final = 64 * 1024
LEAST_WINDOW: Final = 16 * 1024
MOST_WINDOW: Final = 4 * 1024 * 1024
STEP: Final = 64 * 1024
SILENCE: Final = 30.0  # seconds without progress, after which a link is over
KEEPALIVE: Final = 5.0  # seconds without a frame of the peer, after which it is asked for one
LINGER: Final = 5.0  # seconds for the last acknowledgements of both ends
LEAST_WAIT: Final = 0.2  # seconds
MOST_WAIT: Final = 2.0
QUEUE: Final = 0.1  # seconds that frames may stand in queues, before the window shrinks
_SILENCE_PART: Final = 8  # the next try comes after an eighth of the silence so far


class RoundTrip:
    """The smoothed round trip, in seconds; 0 until one was measured."""

    __slots__ = ("_last", "_least", "srtt_s")

    def __init__(self) -> None:
        self.srtt_s = 0.0
        self._last, self._least = 0.0, inf

    def sample(self, seconds: float) -> None:
        """One round trip of a frame that was sent once (Karn's rule)."""
        self.srtt_s = seconds if self.srtt_s == 0.0 else self.srtt_s + (seconds - self.srtt_s) / 8
        self._last, self._least = seconds, min(self._least, seconds)

    @property
    def queueing(self) -> bool:
        """Whether what is sent stands in a queue, perhaps of a slow uplink (RFC 6817)."""
        return self._last > 2 * self._least + QUEUE

    def forget_least(self) -> None:
        """Something was lost: the way may be another one."""
        self._least = inf

    @property
    def wait(self) -> float:
        """How long an acknowledgement may take before it is asked for.

        Asking early costs a small frame, and nothing is sent again for it: it follows the others.
        """
        return max(LEAST_WAIT, min(MOST_WAIT, 4 * self.srtt_s))

    @property
    def repeat(self) -> float:
        """How long a frame that was sent again is not judged: what crossed it says nothing."""
        return max(0.01, 1.25 * self.srtt_s)

    def again(self, silence: float) -> float:
        """How long until it is asked again, after so many seconds without an answer.

        Doubling would sleep for seconds after a router's successor took over.
        """
        return max(LEAST_WAIT, min(MOST_WAIT, max(2 * self.srtt_s, silence / _SILENCE_PART)))


class CongestionWindow:
    """How many bytes may be on the way."""

    __slots__ = ("_recovery", "_threshold", "size")

    def __init__(self) -> None:
        self.size = FIRST_WINDOW
        self._threshold = MOST_WINDOW
        self._recovery = 0

    def acknowledged(self, count: int, on_the_way: int, *, queueing: bool = False) -> None:
        """So many bytes arrived, of so many that were on the way."""
        if queueing:  # more on the way would only make everything on this host wait longer
            if self.size > FIRST_WINDOW:
                self.size = self._threshold = max(FIRST_WINDOW, self.size - count // 4)
            return
        if on_the_way < self.size // 2:  # the writer is slower than the window
            return
        if self.size >= self._threshold:
            count = min(count, STEP * count // self.size)
        self.size = min(MOST_WINDOW, self.size + count)

    def lost(self, offset: int, sent: int) -> None:
        """The frame at `offset` was lost; frames were sent up to `sent`."""
        if offset >= self._recovery:
            self._recovery = sent
            self.size = self._threshold = max(LEAST_WINDOW, self.size // 2)
