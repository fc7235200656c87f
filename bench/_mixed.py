"""An attacker that is never worse than what it could have read plainly.

A model of habits may be wrong of a day, so a program that trusts it alone can be farther off than
one that takes messages at their word. This one has tried both on days it knows, and mixes them as
was best there. What a preset leaves is the best of all: `best`.
"""

from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import numpy as np

from bench._flat import RATE, walk
from bench._trackers import Floats, Habits, scored

Scores = dict[str, dict[str, float]]
KNOWN_DAYS: Final = (101, 102)
_WEIGHTS: Final = tuple(
    (a / 4, b / 4, (4 - a - b) / 4) for a in range(5) for b in range(5 - a)
)  # of the attacker, the naive reading and the habit

# What an attacker, a naive program, and one without messages believe of a path.
Reading = Callable[[Floats], tuple[Floats, Floats, Floats]]


class _Mix(NamedTuple):
    weights: tuple[float, float, float]
    rooms_of: int


def compared(read: Reading, seeds: Sequence[int], seconds: int) -> Scores:
    """The means over days: naive, prior, attacker alone, and the best that remains."""
    known = [(walk(seed, seconds), seed) for seed in KNOWN_DAYS]
    mix = _fitted([(read(path), path[::RATE]) for path, _ in known])
    found: dict[str, list[tuple[float, float]]] = {}
    for seed in seeds:
        path = walk(seed, seconds)
        beliefs = read(path)
        truth = path[::RATE]
        for name, belief in zip(("model", "naive", "prior"), beliefs, strict=True):
            found.setdefault(name, []).append(scored(belief, truth))
        found.setdefault("attacker", []).append(scored(_mixed(beliefs, mix), truth))
    errors = {name: round(float(np.mean([e for e, _ in each])), 3) for name, each in found.items()}
    rooms = {name: round(float(np.mean([r for _, r in each])), 3) for name, each in found.items()}
    return {
        "position_rmse_m": errors | {"best": min(errors.values())},
        "room_accuracy": rooms | {"best": max(rooms.values())},
    }


def _mixed(beliefs: Sequence[Floats], mix: _Mix) -> Floats:
    found = sum(weight * each for weight, each in zip(mix.weights, beliefs, strict=True))
    assert isinstance(found, np.ndarray)
    found[:, 2] = beliefs[mix.rooms_of][:, 2]
    return found


def _fitted(days: Sequence[tuple[Sequence[Floats], Floats]]) -> _Mix:
    def error(weights: tuple[float, float, float]) -> float:
        return sum(scored(_mixed(each, _Mix(weights, 0)), truth)[0] for each, truth in days)

    def right(number: int) -> float:
        return sum(scored(each[number], truth)[1] for each, truth in days)

    return _Mix(min(_WEIGHTS, key=error), max(range(3), key=right))


def reading(told: Callable[[Floats], Floats], naive: Callable[[Floats], Floats], known: Habits) -> Reading:
    """A reading of these two and of the habit."""

    def read(path: Floats) -> tuple[Floats, Floats, Floats]:
        prior = np.empty((len(path) // RATE, 3))
        prior[:] = (*known.mean, known.room)
        return told(path), naive(path), prior

    return read
