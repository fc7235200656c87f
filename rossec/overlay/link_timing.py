"""Round trips of a link, how much may be on the way, and when an answer is overdue. Pure.

The congestion window doubles each round trip until something is lost, then grows by 64 KiB; a loss
halves it, once for all that was on the way then: routers drop what they cannot queue. Before that,
the kernel and routers queue megabytes, behind which every other stream of the link would wait for
seconds on a slow line: so a round trip that grew by `QUEUE` shrinks the window too (as LEDBAT,
RFC 6817).
"""

from typing import Final

FIRST_WINDOW: Final = 64 * 1024
LEAST_WINDOW: Final = 16 * 1024
MOST_WINDOW: Final = 4 * 1024 * 1024
STEP: Final = 64 * 1024
SILENCE: Final = 30.0  # seconds without progress, after which a link is over
KEEPALIVE: Final = 5.0  # seconds without a frame of the peer, after which it is asked for one
LINGER: Final = 5.0  # seconds for the last acknowledgements of both ends
QUEUE: Final = 0.1  # seconds that bytes of this link may wait in queues
LEAST_WAIT: Final = 0.2  # seconds
MOST_WAIT: Final = 2.0
_SILENCE_PART: Final = 8  # the next try comes after an eighth of the silence so far


class RoundTrip:
    """The smoothed and the shortest round trip, in seconds; 0 until one was measured."""

    __slots__ = ("least_s", "srtt_s")

    def __init__(self) -> None:
        self.srtt_s = 0.0
        self.least_s = 0.0

    def sample(self, seconds: float) -> None:
        """One round trip of a frame that was sent once (Karn's rule)."""
        self.srtt_s = seconds if self.srtt_s == 0.0 else self.srtt_s + (seconds - self.srtt_s) / 8
        self.least_s = min(self.least_s or seconds, seconds)

    @property
    def queued_s(self) -> float:
        """How long bytes wait on the way, by what the way takes at best."""
        return self.srtt_s - self.least_s

    def way_changed(self) -> None:
        """Another way may be as long at best as this one is now."""
        self.least_s = self.srtt_s

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

    __slots__ = ("_delayed", "_recovery", "_threshold", "size")

    def __init__(self) -> None:
        self.size = FIRST_WINDOW
        self._threshold = MOST_WINDOW
        self._recovery = 0
        self._delayed = 0  # bytes that arrived late since the window was shrunk

    def acknowledged(self, count: int, on_the_way: int, queued_s: float = 0.0) -> None:
        """So many bytes arrived, of so many that were on the way, after waiting in queues."""
        if queued_s > QUEUE:
            self._shrink(count)
            return
        if on_the_way < self.size // 2:  # the writer is slower than the window
            return
        if self.size >= self._threshold:
            count = min(count, STEP * count // self.size)
        self.size = min(MOST_WINDOW, self.size + count)

    def _shrink(self, count: int) -> None:
        """By a quarter each round trip."""
        self._delayed += count
        if self._delayed >= self.size:
            self._delayed = 0
            self.size = self._threshold = max(LEAST_WINDOW, self.size - self.size // 4)

    def lost(self, offset: int, sent: int) -> None:
        """The frame at `offset` was lost; frames were sent up to `sent`."""
        if offset >= self._recovery:
            self._recovery = sent
            self.size = self._threshold = max(LEAST_WINDOW, self.size // 2)
