"""What following another master goes through, as a table. Pure.

Facts of a site that fell silent stay for a minute, marked: a master that restarts, or a link that
comes back, disturbs nobody. What the site refuses, and what was removed here, goes at once. Nothing
here cuts a connection between nodes: they judge each other without any master.
"""

from enum import Enum
from typing import Final

from rossec.errors import FederationError

SILENCE: Final = 12.0  # seconds without an answer; a poll is answered after at most 5
LOST_FOR: Final = 60.0  # seconds that facts stay without a connection
FIRST_PAUSE: Final = 1.0
LONGEST_PAUSE: Final = 30.0
_SPREAD: Final = 0.2  # or all masters of a site would return at the same moment


class Phase(Enum):
    """How far a site is followed."""

    IDLE = "idle"
    DIALLING = "dialling"
    GREETING = "greeting"
    FOLLOWING = "following"
    LISTENING = "listening"
    LOST = "lost"


class Event(Enum):
    """What happens to a site."""

    DUE = "it is time to dial"
    CONNECTED = "there is a connection"
    ANSWERED = "the site has answered, and the answer is taken over"
    HIDDEN = "the site shows nothing of its graph, only what is revoked"
    FAILED = "no connection, no answer, or an invalid one"
    REFUSED = "the site is another one, or refuses"
    EXPIRED = "the facts of a lost site are too old"
    REMOVED = "it is followed no longer"


class Effect(Enum):
    """What becomes of the site's facts."""

    NONE = "nothing"
    MARK = "they are marked as lost"
    EXPIRE = "they go, and connections with the site's nodes stay"
    DROP = "they go, and subscribers here leave the site's publishers"


_CONNECTING: Final = (Phase.DIALLING, Phase.GREETING)
_OPEN: Final = (*_CONNECTING, Phase.FOLLOWING, Phase.LISTENING)
TABLE: Final = {
    (Phase.IDLE, Event.DUE): (Phase.DIALLING, Effect.NONE),
    (Phase.LOST, Event.DUE): (Phase.DIALLING, Effect.NONE),
    (Phase.FOLLOWING, Event.DUE): (Phase.DIALLING, Effect.NONE),  # local nodes want more
    (Phase.DIALLING, Event.CONNECTED): (Phase.GREETING, Effect.NONE),
    (Phase.GREETING, Event.ANSWERED): (Phase.FOLLOWING, Effect.NONE),
    (Phase.FOLLOWING, Event.ANSWERED): (Phase.FOLLOWING, Effect.NONE),
    (Phase.GREETING, Event.HIDDEN): (Phase.LISTENING, Effect.DROP),
    (Phase.FOLLOWING, Event.HIDDEN): (Phase.LISTENING, Effect.DROP),
    (Phase.LISTENING, Event.DUE): (Phase.DIALLING, Effect.NONE),  # it may show more now
    **{(at, Event.FAILED): (Phase.LOST, Effect.MARK) for at in _OPEN},
    **{(at, Event.REFUSED): (Phase.IDLE, Effect.DROP) for at in _OPEN},
    **{(at, Event.EXPIRED): (at, Effect.EXPIRE) for at in (*_CONNECTING, Phase.LOST)},
    **{(at, Event.REMOVED): (Phase.IDLE, Effect.DROP) for at in Phase},
}


class SiteState:
    """Where one site is in the table, since when it is lost, and how long to wait.

    Attributes:
        phase: where it is.
        lost_since: when the connection was lost on which it was followed, by a monotonic clock;
            None: it is followed, or its facts are gone.
        failures: since it was followed.
    """

    def __init__(self) -> None:
        self.phase = Phase.IDLE
        self.lost_since: float | None = None
        self.failures = 0
        self._has_facts = False

    def take(self, event: Event, clock: float) -> Effect:
        """Go where the table says; returns what becomes of the facts.

        Raises:
            FederationError: the event is not in the table.
        """
        found = TABLE.get((self.phase, event))
        if found is None:
            raise FederationError(f"a site that is {self.phase.value}, and: {event.value}")
        self.phase, effect = found
        if event in (Event.FAILED, Event.REFUSED):
            self.failures += 1
        if event is Event.ANSWERED:
            self.lost_since, self.failures, self._has_facts = None, 0, True
        elif effect in (Effect.EXPIRE, Effect.DROP):
            self.lost_since, self._has_facts = None, False
            self.failures = 0 if event is Event.HIDDEN else self.failures
        elif event is Event.FAILED and self._has_facts and self.lost_since is None:
            self.lost_since = clock
        return effect

    def has_expired(self, clock: float) -> bool:
        """Whether `EXPIRED` is due."""
        return self.lost_since is not None and clock - self.lost_since >= LOST_FOR

    def pause(self, rand: float, longest: float = LONGEST_PAUSE) -> float:
        """Seconds to wait before the next dial, about; `rand` is from 0 up to 1."""
        pause = min(FIRST_PAUSE * 2.0 ** min(max(self.failures - 1, 0), 16), longest)
        return pause * (1 + _SPREAD * (2 * rand - 1))
