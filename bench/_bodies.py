"""Who gets the position of one body more than once: two receivers, two topics, two frames.

Everything that arrives goes into one tracker (`_trackers.track`). A topic that is shifted has the
same body in a frame of its own, as odometry has. Of each stream it is known which filter it has.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Final, NamedTuple

from bench._flat import RATE
from bench._trackers import Floats, Likelihood, Told, grid
from bench._views import NOW, Publisher, by_preset, pose_place, poses
from grants.guard import Guard
from grants.model import Restriction

POSE: Final = "geometry_msgs/PoseStamped"
SHIFT: Final = (1.3, -0.9)  # of odometry that began elsewhere


class Tap(NamedTuple):
    """One stream: who receives it, of which topic, from when on, and how it is shifted."""

    receiver: int = 1
    topic: str = "/topic"
    since: int = 0
    shift: tuple[float, float] = (0.0, 0.0)


COARSE: Final = {
    "two-receivers": (Tap(1), Tap(2, since=400)),
    "two-topics": (Tap(1), Tap(1, "/other", 200)),
    "two-frames": (Tap(1), Tap(1, "/other", shift=SHIFT)),
}


def streams(
    taps: tuple[Tap, ...], path: Floats, body: str | None, restriction: Restriction | None = None
) -> list[list[Told]]:
    """What each of the taps is told of a path, all by one publisher."""
    given = replace(restriction or by_preset("coarse-position", POSE), body=body)
    publisher = Publisher(POSE)
    guards = [publisher.guard(given, tap.receiver, tap.topic) for tap in taps]
    sources = [poses(path + tap.shift, RATE, _frame(tap)) for tap in taps]
    told: list[list[Told]] = [[] for _ in taps]
    for number, messages in enumerate(zip(*sources, strict=True)):
        for tap, guard, kept, (at, message) in zip(taps, guards, told, messages, strict=True):
            if number >= tap.since * RATE:
                kept.extend(_told(guard, at, message))
    return told


def likelihoods(step: float, hysteresis: float, taps: tuple[Tap, ...]) -> list[Likelihood]:
    """What is known of each stream."""
    return [grid(step, hysteresis, tap.shift) for tap in taps]


def _frame(tap: Tap) -> bytes:
    return b"map" if tap.shift == (0.0, 0.0) else b"odo"


def _told(guard: Guard, at: float, message: bytes) -> Iterator[Told]:
    pieces = guard.apply(message, NOW + at)
    if pieces is not None:
        yield Told(int(at), *pose_place(b"".join(pieces)))
