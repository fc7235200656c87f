"""Work that others must not wait for: done in turns, each of which ends by time. Pure.

A count bounds nothing here, since one call may cost ten thousand times another. What is worked at
yields wherever it can be left; `over`, which asks the caller's clock, says when it must be.
"""

from collections.abc import Callable, Generator
from typing import Final, NamedTuple, TypeAlias

from rossec.master.api.methods import MasterEvent

TURN: Final = 0.005  # seconds that one peer may keep the loop before others are answered

Over = Callable[[], bool]
"""Whether the turn has lasted long enough."""


class CallOutcome(NamedTuple):
    """What to answer and what to deliver."""

    answer: object
    events: tuple[MasterEvent, ...] = ()


Work: TypeAlias = Generator[None, None, CallOutcome]
"""A call that may take many turns."""


class Turns:
    """Hands out turns of `length` seconds, by a clock that only goes forward."""

    def __init__(self, clock: Callable[[], float], length: float = TURN) -> None:
        self._clock = clock
        self._length = length

    def begin(self) -> Over:
        """A turn that begins now."""
        end = self._clock() + self._length
        return lambda: self._clock() >= end


def never() -> bool:
    """For what is done to its end."""
    return False


def advance(work: Work, over: Over) -> CallOutcome | None:
    """Work for one turn; None: it is not at its end."""
    try:
        while True:
            next(work)
            if over():
                return None
    except StopIteration as end:
        outcome: CallOutcome = end.value
        return outcome


def finished(work: Work) -> CallOutcome:
    """Work to the end."""
    while (outcome := advance(work, never)) is None:
        pass
    return outcome
