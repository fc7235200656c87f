"""What attackers' programs get out of the presets: how far off, how often right.

Each figure stands beside others: `naive`, what a program reads that takes messages at their word,
and `prior`, what is known without any message. What a preset leaves is `best`, the best that any of
them gets, over ten days. Everything is simulated by fixed seeds and goes through the guard of the
product, so the figures do not depend on the machine; they depend on the simulated habits, faces and
faults, and are for comparing one version with the next. Attackers: `_trackers` (a hidden Markov
model over the flat), `_mixed`, `_bodies` (several topics and receivers), `_outdoors`, `_watchers`
(matched filters), `_registrations` (the master), `_linkers` (levels), `_faces` (a gallery),
`_observers` (the network). Attackers of others got more at places: grant.md has the worse of both.
"""

import argparse
from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple

from bench._bodies import COARSE, Tap, likelihoods, streams
from bench._faces import faces
from bench._flat import PLAN, RATE
from bench._linkers import linked_parts
from bench._mixed import Reading, compared, reading
from bench._observers import observed
from bench._outdoors import driven, movements, wheels
from bench._registrations import registered
from bench._trackers import TRAINING, Floats, Likelihood, Told, grid, habits, hold, rooms, track
from bench._views import by_preset, pose_place, poses, received
from bench._watchers import watched
from grants.model import Restriction, filter_rules

PARSER: Final = argparse.ArgumentParser(prog="python -m bench privacy", description=__doc__)
PARSER.add_argument("--quick", action="store_true", help="two days instead of ten, fewer faces")

POSE: Final = "geometry_msgs/PoseStamped"
DAYS: Final = tuple(range(2, 12))
_ROOMS: Final = {"pose.position": {"rooms": {**PLAN, "hysteresis": 0.5}}}
_RECONNECT: Final = 2  # messages: every 0.2 s

Scores = dict[str, dict[str, float]]


class View(NamedTuple):
    """A restriction, what an attacker knows of it, and how it receives.

    Args:
        every: connects anew after so many messages.
        taps: what arrives together; None: one topic.
        body: whether the policy calls it one body.
    """

    made: Callable[[], Restriction]
    likelihood: Likelihood
    every: int | None = None
    taps: tuple[Tap, ...] | None = None
    body: str | None = None


def _filtered(
    rules: dict[str, Any], rate: float | None = None, slot: int | None = None
) -> Callable[[], Restriction]:
    return lambda: Restriction(POSE, (), filter_rules(rules), rate, slot=slot)


def _coarse() -> Restriction:
    return by_preset("coarse-position", POSE)


_CELLS: Final = grid(4, 2)
POSITIONS: Final[dict[str, View]] = {
    "coarse-position": View(_coarse, _CELLS),
    "coarse-position-reconnecting": View(_coarse, _CELLS, _RECONNECT),
    **{name: View(_coarse, _CELLS, None, taps) for name, taps in COARSE.items()},
    **{
        f"{name}-one-body": View(_coarse, _CELLS, None, taps, "robot")
        for name, taps in COARSE.items()
        if name != "two-receivers"
    },
    "rooms": View(_filtered(_ROOMS, slot=30), rooms(0.5)),
    # No preset: a grid alone, as is written first.
    "round-2m": View(_filtered({"pose.position": {"round": {"step": 2.0}}}), grid(2, 0)),
}


def measure(seconds: float, *, quick: bool = False) -> dict[str, object]:
    """All presets, for hours of a simulated home; `seconds` are not used up, nor kept to."""
    del seconds
    days = DAYS[:2] if quick else DAYS
    return {
        **positions(3600, TRAINING, days=days),
        "outdoors": {level: driven(level, range(2, 4 if quick else 12), 8) for level in ("room", "area")},
        "joints-of-wheels": wheels(3600),
        "sends-when-it-moves": movements(8 * 3600),
        "presence-only": watched(by_preset("presence-only", "std_msgs/String"), 8 * 3600),
        "presence-by-registration": registered(60, 8 * 3600),
        "anonymous-diagnostics": linked_parts((2, 10) if quick else (2, 10, 60)),
        "blurred-camera": {
            f"{size}_px": faces(size, 10 if quick else 50, (1, 10) if quick else (1, 10, 50))
            for size in ((64,) if quick else (64, 96, 128, 192))
        },
        "network": observed(days, 3600),
    }


def positions(
    seconds: int, training: int, names: Sequence[str] = tuple(POSITIONS), days: Sequence[int] = DAYS
) -> dict[str, Scores]:
    """The error in metres and the share of right rooms, by name."""
    return {name: compared(_reading(POSITIONS[name], seconds, training), days, seconds) for name in names}


def _reading(view: View, seconds: int, training: int) -> Reading:
    known = habits(training)
    last: list[list[Told]] = []

    def told(path: Floats) -> Floats:
        last[:] = _received(view, path)
        taps = (Tap(),) if view.taps is None else view.taps
        given = [view.likelihood] if view.taps is None else likelihoods(4, 2, taps)
        return track(list(zip(last, given, strict=True)), seconds, known)

    return reading(told, lambda _: hold(last[0], seconds, known), known)


def _received(view: View, path: Floats) -> list[list[Told]]:
    if view.taps is not None:
        return streams(view.taps, path, view.body, view.made())
    messages = received(POSE, view.made(), poses(path, RATE), view.every)
    return [[Told(int(at), *pose_place(message)) for at, message in messages]]
