"""What attackers' programs get out of the presets: how far off, how often right.

Each figure stands beside two others: `naive`, what a program reads that takes messages at their
word, and `prior`, what is known without any message. `attacker` between prior and truth is what a
preset leaves. Everything is simulated by fixed seeds and goes through the guard of the product, so
the figures do not depend on the machine; they depend on the simulated habits, faces and faults, and
are for comparing one version with the next. Attackers: `_trackers` (a hidden Markov model over the
flat), `_watchers` (matched filters), `_linkers` (galleries).
"""

from collections.abc import Callable, Sequence
from typing import Any, Final

from bench._flat import PLAN, RATE, walk
from bench._linkers import faces, linked_parts
from bench._trackers import TRAINING, Likelihood, Told, grid, habits, hold, rooms, scored, track
from bench._views import by_preset, pose_place, poses, received
from bench._watchers import watched
from grants.model import Restriction, filter_rules

POSE: Final = "geometry_msgs/PoseStamped"
_ROOMS: Final = {"pose.position": {"rooms": {**PLAN, "hysteresis": 0.5}}}
_RECONNECT: Final = 2  # messages: every 0.2 s

Scores = dict[str, dict[str, float]]
# By name: the restriction, what an attacker knows of it, and whether it connects anew all the time.
View = tuple[Callable[[], Restriction], Likelihood, int | None]


def _filtered(rules: dict[str, Any], rate: float | None = None) -> Callable[[], Restriction]:
    return lambda: Restriction(POSE, (), filter_rules(rules), rate)


def _coarse() -> Restriction:
    return by_preset("coarse-position", POSE)


POSITIONS: Final[dict[str, View]] = {
    "coarse-position": (_coarse, grid(4, 2), None),
    "coarse-position-reconnecting": (_coarse, grid(4, 2), _RECONNECT),
    "rooms": (_filtered(_ROOMS, 1 / 30), rooms(0.5), None),
    # No preset: a grid alone, as is written first.
    "round-2m": (_filtered({"pose.position": {"round": {"step": 2.0}}}), grid(2, 0), None),
}


def measure(seconds: float) -> dict[str, object]:
    """All presets, for an hour of a simulated home; `seconds` are not used up, nor kept to."""
    del seconds
    return {
        **positions(3600, TRAINING),
        "presence-only": watched(by_preset("presence-only", "std_msgs/String"), 8 * 3600),
        "anonymous-diagnostics": linked_parts((2, 10, 60)),
        "blurred-camera": faces(50, 40),
    }


def positions(
    seconds: int, training: int, names: Sequence[str] = tuple(POSITIONS)
) -> dict[str, Scores]:
    """The error in metres and the share of right rooms, by name."""
    return {name: _tracked(POSITIONS[name], seconds, training) for name in names}


def _tracked(view: View, seconds: int, training: int) -> Scores:
    made, likelihood, every = view
    path = walk(2, seconds)
    messages = received(POSE, made(), poses(path, RATE), every)
    told = [Told(int(at), *pose_place(message)) for at, message in messages]
    truth, known = path[::RATE], habits(training)
    found = {
        "naive": scored(hold(told, seconds, known), truth),
        "prior": scored(hold([], seconds, known), truth),
        "attacker": scored(track(told, likelihood, seconds, known), truth),
    }
    return {
        "position_rmse_m": {name: error for name, (error, _) in found.items()},
        "room_accuracy": {name: right for name, (_, right) in found.items()},
    }
