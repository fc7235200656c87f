"""When to reconnect after a connection is lost. Pure.

Soon at first, as a restarted master is back within seconds; less often after `FAST_PERIOD`, when it
was probably switched off. Each pause is shortened at random by up to a half, or all nodes of a
graph would reconnect at the same moment.
"""

from collections.abc import Callable
from typing import Final

FIRST: Final = 0.25
FAST_PERIOD: Final = 30.0  # seconds from the loss on
_LONGEST_FAST: Final = 1.0
_LONGEST: Final = 5.0


class Retry:
    """The pauses after one loss, until `succeeded`.

    Args:
        rand: returns a random number from 0 up to 1.
    """

    def __init__(self, rand: Callable[[], float]) -> None:
        self._rand = rand
        self.succeeded()

    def succeeded(self) -> None:
        """The next failure is a new loss."""
        self._pause, self._lost_at = FIRST / 2, -1.0

    def pause(self, now: float) -> float:
        """Seconds to wait after a failure at `now`."""
        if self._lost_at < 0:
            self._lost_at = now
        longest = _LONGEST_FAST if now - self._lost_at < FAST_PERIOD else _LONGEST
        self._pause = min(2 * self._pause, longest)
        return self._pause * (1 - self._rand() / 2)
