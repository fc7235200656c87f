"""Long calls are processed in turns of limited time, so that they do not delay others. Pure.

A count would not limit the time, since one call may cost ten thousand times as much as another. A
generator yields where it can be suspended; `expired`, which reads the caller's clock, says when.
"""

from collections.abc import Callable, Generator
from typing import Final, NamedTuple, TypeAlias

from rossec.master.api.methods import MasterEvent

TURN: Final = 0.005  # seconds that one call may occupy the loop

TurnExpired = Callable[[], bool]
"""Whether the turn has expired."""


class CallOutcome(NamedTuple):
    """The answer and the events to deliver."""

    answer: object
    events: tuple[MasterEvent, ...] = ()


Work: TypeAlias = Generator[None, None, CallOutcome]
"""A call that may take many turns."""


class Turns:
    """Begins turns of `length` seconds by a monotonic clock."""

    def __init__(self, clock: Callable[[], float], length: float = TURN) -> None:
        self._clock = clock
        self._length = length

    def begin(self) -> TurnExpired:
        """Begin a turn now; returns whether it has expired."""
        end = self._clock() + self._length
        return lambda: self._clock() >= end


def advance(work: Work, expired: TurnExpired) -> CallOutcome | None:
    """Run `work` for one turn; None: it is not finished."""
    try:
        while True:
            next(work)
            if expired():
                return None
    except StopIteration as end:
        outcome: CallOutcome = end.value
        return outcome
