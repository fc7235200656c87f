"""The states of a link, what changes them, and what a link tells of itself. Pure."""

from dataclasses import dataclass
from enum import IntEnum, auto
from typing import Final


class LinkState(IntEnum):
    """Where a link is."""

    IDLE = auto()  # called from here, and nothing written yet
    OPENING = auto()  # OPEN was sent
    RUNNING = auto()
    DRAINING = auto()  # `finish` was called
    DONE = auto()  # both sides ended
    RESET = auto()


ENDED: Final = frozenset({LinkState.DONE, LinkState.RESET})
OPEN: Final = frozenset({LinkState.RUNNING, LinkState.DRAINING})
NEXT: Final = {
    (LinkState.IDLE, "write"): LinkState.OPENING,
    (LinkState.IDLE, "finish"): LinkState.DONE,
    (LinkState.OPENING, "answer"): LinkState.RUNNING,
    (LinkState.RUNNING, "finish"): LinkState.DRAINING,
    (LinkState.DRAINING, "drained"): LinkState.DONE,
}
"""What changes a state; a reset ends every one, and the rest changes none."""


@dataclass(frozen=True, slots=True)
class LinkStats:
    """What a link measured: round trips (smoothed, least; 0: none yet), octets of its streams."""

    srtt_s: float
    retransmissions: int
    sent: int
    received: int
    least_s: float = 0.0
