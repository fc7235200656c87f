"""How much a peer may send in one direction of a stream before it is taken. Pure.

A window begins small and grows while the program takes half of it within a round trip and lets
nothing wait (as TCP's receive buffer, "dynamic right-sizing"): then the window is what limits it.
It is measured by the round trip of an idle way, so that a window does not grow by the queue that it
makes. A program that lags gets no credit until its window has shrunk again. What windows have
beyond the first one comes out of a fund that the link's streams share.
"""

from typing import Final

FIRST: Final = 256 * 1024  # bytes
MOST: Final = 4 * 1024 * 1024  # the window of a link
FUND: Final = 32 * 1024 * 1024
SHORTEST_ROUND: Final = 0.005  # seconds: two relays and two programs take turns


class Fund:
    """Bytes that the windows of one link may have beyond their first ones."""

    __slots__ = ("left",)

    def __init__(self, left: int = FUND) -> None:
        self.left = left


class ReceiveWindow:
    """One direction of a stream at its receiver; `allowed`: what the peer may still send.

    `allowed` and `held` (bytes that arrived and were not taken) are never more than `size`.
    """

    __slots__ = ("_began", "_fund", "_taken", "allowed", "held", "size")

    def __init__(self, fund: Fund) -> None:
        self.size = self.allowed = FIRST
        self.held = 0
        self._fund = fund
        self._began = 0.0  # when the round began in which `_taken` bytes were taken
        self._taken = 0

    def arrived(self, length: int) -> None:
        """The peer sent so many of the bytes it may send."""
        self.allowed -= length
        self.held += length

    def took(self, count: int, now: float, round_trip_s: float) -> int:
        """The program took `count` bytes; the credit to give, if it is time.

        Args:
            round_trip_s: of the link when it is idle; 0 if that is not known.
        """
        if count > self.held:
            raise ValueError("more was taken than arrived")
        self.held -= count
        self._taken += count
        if round_trip_s > 0:
            self._adapt(now, max(round_trip_s, SHORTEST_ROUND))
        credit = self.size - self.allowed - self.held
        if credit < self.size // 4:
            return 0
        self.allowed += credit
        return credit

    def _adapt(self, now: float, round_s: float) -> None:
        """Once in a round."""
        elapsed = now - self._began
        if elapsed < round_s:
            return
        wanted = int(2 * self._taken * round_s / elapsed)
        self._began, self._taken = now, 0
        if self.held > self.size // 2:
            self._resize(max(FIRST, self.size // 2, self.allowed + self.held))
        elif wanted > self.size and self.held == 0:
            self._resize(min(wanted, 2 * self.size, MOST, self.size + self._fund.left))

    def _resize(self, size: int) -> None:
        self._fund.left -= size - self.size
        self.size = size

    def close(self) -> None:
        """The stream is over."""
        self._resize(FIRST)
