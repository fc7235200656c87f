"""When a topic is subscribed at its origin, as a table. Pure.

Only while somebody here is subscribed, and a little longer: a program that is started again, or
one after the other, makes no new connection over the slow line each time.
"""

from enum import Enum
from typing import Final

from rossec.errors import GatewayError

LINGER: Final = 5.0  # seconds without a subscriber here until the origin is left
FIRST_PAUSE: Final = 1.0  # seconds after a failure, doubled with each further one
LONGEST_PAUSE: Final = 15.0


class Phase(Enum):
    """How far a topic is."""

    IDLE = "idle"  # nobody is subscribed here
    SUBSCRIBED = "subscribed"
    LINGERING = "lingering"  # subscribed at the origin, and nobody here
    PAUSED = "paused"  # the master refused the subscription: tried again later


class Event(Enum):
    """What happens to a topic."""

    WANTED = "somebody here is subscribed"
    UNWANTED = "nobody here is subscribed any more"
    DUE = "the time is over"
    FAILED = "the subscription failed"


class Action(Enum):
    """What is to be done."""

    NOTHING = "nothing"
    SUBSCRIBE = "subscribe at the origin"
    LEAVE = "end the subscription"


TABLE: Final = {
    (Phase.IDLE, Event.WANTED): (Phase.SUBSCRIBED, Action.SUBSCRIBE),
    (Phase.SUBSCRIBED, Event.UNWANTED): (Phase.LINGERING, Action.NOTHING),
    (Phase.SUBSCRIBED, Event.FAILED): (Phase.PAUSED, Action.LEAVE),
    (Phase.LINGERING, Event.WANTED): (Phase.SUBSCRIBED, Action.NOTHING),
    (Phase.LINGERING, Event.DUE): (Phase.IDLE, Action.LEAVE),
    (Phase.LINGERING, Event.FAILED): (Phase.IDLE, Action.LEAVE),
    (Phase.PAUSED, Event.DUE): (Phase.SUBSCRIBED, Action.SUBSCRIBE),
    (Phase.PAUSED, Event.UNWANTED): (Phase.IDLE, Action.NOTHING),
}
_WANTED_IN: Final = frozenset({Phase.SUBSCRIBED, Phase.PAUSED})


class TopicState:
    """Where one topic is in the table; times are of a monotonic clock.

    Attributes:
        phase: where it is.
        due: when `step` has to be called at the latest; None: when something changes.
    """

    def __init__(self) -> None:
        self.phase = Phase.IDLE
        self.due: float | None = None
        self._pause = FIRST_PAUSE

    def step(self, now: float, *, wanted: bool) -> Action:
        """What is to be done now; called until it is nothing.

        Args:
            wanted: whether somebody here is subscribed, or waits to be.
        """
        event = self._event(now, wanted=wanted)
        return Action.NOTHING if event is None else self._enter(event, now)

    def _event(self, now: float, *, wanted: bool) -> Event | None:
        if wanted and self.phase not in _WANTED_IN:
            return Event.WANTED
        if not wanted and self.phase in _WANTED_IN:
            return Event.UNWANTED
        return Event.DUE if self.due is not None and now >= self.due else None

    def failed(self, now: float) -> Action:
        """The subscription was refused, or ended by an error."""
        action = self._enter(Event.FAILED, now)
        self._pause = min(2 * self._pause, LONGEST_PAUSE)
        return action

    def connected(self) -> None:
        """A publisher of the origin is connected: the next failure is a new one."""
        self._pause = FIRST_PAUSE

    def _enter(self, event: Event, now: float) -> Action:
        if (self.phase, event) not in TABLE:
            raise GatewayError(f"a topic that is {self.phase.value}, and then: {event.value}")
        self.phase, action = TABLE[self.phase, event]
        waits = {Phase.LINGERING: LINGER, Phase.PAUSED: self._pause}.get(self.phase)
        self.due = None if waits is None else now + waits
        return action
