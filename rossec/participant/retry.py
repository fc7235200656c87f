"""When to try again what is lost. Pure.

Soon at first, for a master that was started again is there within seconds; less often after
`EAGER`, for then somebody has switched it off. Each pause is cut by up to a half, or all nodes of a
graph would come in the same moment.
"""

from collections.abc import Callable
from typing import Final

FIRST: Final = 0.25
EAGER: Final = 30.0  # seconds from the loss on
_LONGEST_EAGER: Final = 1.0
_LONGEST: Final = 5.0


class Retry:
    """The pauses after one loss, until `succeeded`.

    Args:
        dice: a random number from 0 up to 1.
    """

    def __init__(self, dice: Callable[[], float]) -> None:
        self._dice = dice
        self.succeeded()

    def succeeded(self) -> None:
        """The next failure is a new loss."""
        self._pause, self._lost = FIRST / 2, -1.0

    def pause(self, now: float) -> float:
        """Seconds to wait after a failure at `now`."""
        if self._lost < 0:
            self._lost = now
        longest = _LONGEST_EAGER if now - self._lost < EAGER else _LONGEST
        self._pause = min(2 * self._pause, longest)
        return self._pause * (1 - self._dice() / 2)
