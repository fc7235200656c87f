"""Work that others must not wait for: done in turns, each of which ends by time. Pure.

A count bounds nothing here, since one call may cost ten thousand times another. What is worked at
yields wherever it can be left; `expired`, which asks the caller's clock, says when it must be.
"""

from collections.abc import Callable, Generator
from typing import Final, NamedTuple, TypeAlias

from rossec.master.api.methods import MasterEvent

TURN: Final = 0.005  # seconds that one peer may keep the loop before others are answered

TurnExpired = Callable[[], bool]
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

    def begin(self) -> TurnExpired:
        """A turn that begins now."""
        end = self._clock() + self._length
        return lambda: self._clock() >= end


def never_expires() -> bool:
    """For what is done to its end."""
    return False


def advance(work: Work, expired: TurnExpired) -> CallOutcome | None:
    """Work for one turn; None: it is not at its end."""
    try:
        while True:
            next(work)
            if expired():
                return None
    except StopIteration as end:
        outcome: CallOutcome = end.value
        return outcome


def run_to_end(work: Work) -> CallOutcome:
    """Work to the end."""
    while (outcome := advance(work, never_expires)) is None:
        pass
    return outcome
