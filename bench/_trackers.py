"""Who wants to know where somebody is, and gets a filtered position.

The tracker knows the flat and has seen its inhabitant for twenty hours without any filter, which
nobody outside has: it is an upper bound. What it does not know is today. It keeps every message,
knows the filter, and takes the time of arrival, whatever the stamps say. A hidden Markov model over
cells of half a metre, forward and backward.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from bench._flat import RATE, WALLS_X, WALLS_Y, room_of, walk

Floats = npt.NDArray[np.float64]

CELL: Final = 0.5
TRAINING: Final = 20 * 3600  # seconds
_FLOOR: Final = 1e-3  # what a model thinks impossible happens this often


class Told(NamedTuple):
    """One message: the second of its arrival, and its position."""

    second: int
    x: float
    y: float


Likelihood = Callable[[Told, Told | None], Floats]  # of each cell, by a message and that before


def _centres() -> Floats:
    xs = np.arange(WALLS_X[0] + CELL / 2, WALLS_X[-1], CELL)
    ys = np.arange(WALLS_Y[0] + CELL / 2, WALLS_Y[-1], CELL)
    return np.array([(x, y) for y in ys for x in xs])


CENTRES: Final = _centres()
_ACROSS: Final = len(np.unique(CENTRES[:, 0]))
_CELL_ROOMS: Final = room_of(CENTRES[:, 0], CENTRES[:, 1])


@dataclass(frozen=True)
class Habits:
    """What is known without a message: how often each cell, and where one goes from it."""

    occupied: Floats
    moves: Floats
    mean: tuple[float, float]
    room: int


@cache
def habits(seconds: int = TRAINING, seed: int = 1) -> Habits:
    """The habits, from so many seconds without a filter."""
    path = walk(seed, seconds)[::RATE]
    cells = _cells(path)
    count = len(CENTRES)
    moves = np.eye(count) * 0.5 + _FLOOR * _neighbours()
    np.add.at(moves, (cells[:-1], cells[1:]), 1)
    occupied = np.bincount(cells, minlength=count) + 0.1
    rooms = np.bincount(room_of(path[:, 0], path[:, 1]), minlength=6)
    x, y = path.mean(axis=0)
    return Habits(
        occupied / occupied.sum(),
        moves / moves.sum(axis=1, keepdims=True),
        (float(x), float(y)),
        int(rooms.argmax()),
    )


def _cells(path: Floats) -> npt.NDArray[np.intp]:
    low = np.array([WALLS_X[0], WALLS_Y[0]])
    down = len(CENTRES) // _ACROSS
    at = np.clip(((path - low) / CELL).astype(int), 0, [_ACROSS - 1, down - 1])
    return np.asarray(at[:, 1] * _ACROSS + at[:, 0])


def _neighbours() -> Floats:
    distance = np.abs(CENTRES[:, np.newaxis] - CENTRES[np.newaxis]).max(axis=2)
    return np.where(distance < 1.5 * CELL, 1.0, 0.0)


def grid(step: float, hysteresis: float, shift: tuple[float, float] = (0.0, 0.0)) -> Likelihood:
    """What a rounded position tells: its cell, and that it is not far outside of the last one."""

    def likelihood(told: Told, before: Told | None) -> Floats:
        found = np.ones(len(CENTRES))
        last = (None, None) if before is None else (before.x, before.y)
        for axis, (value, earlier) in enumerate(zip((told.x, told.y), last, strict=True)):
            half = step / 2 + (hysteresis if value == earlier else 0)
            at = value - shift[axis]
            overlap = np.minimum(CENTRES[:, axis] + CELL / 2, at + half) - np.maximum(
                CENTRES[:, axis] - CELL / 2, at - half
            )
            found *= np.clip(overlap / CELL, _FLOOR, 1)
        return found

    return likelihood


def rooms(reach: float) -> Likelihood:
    """What a room tells: that the position is in it, or was and is not far outside."""

    def likelihood(told: Told, before: Told | None) -> Floats:
        room = int(room_of(told.x, told.y))
        inside = np.where(room == _CELL_ROOMS, 1.0, 0.0)
        if before is not None and (before.x, before.y) == (told.x, told.y):
            near = np.abs(CENTRES[:, np.newaxis] - CENTRES[inside > 0][np.newaxis]).max(axis=2)
            inside = np.where(near.min(axis=1) <= reach, 1.0, 0.0)
        return np.asarray(np.maximum(inside, _FLOOR))

    return likelihood


def track(streams: Sequence[tuple[Sequence[Told], Likelihood]], seconds: int, known: Habits) -> Floats:
    """For each second: x, y, and the number of the room, as an attacker believes afterwards.

    Of two streams that say the same at the same time one is used.
    """
    seen = np.ones((seconds, len(CENTRES)))
    used: set[Told] = set()
    for told, likelihood in streams:
        before: Told | None = None
        for each in told:
            if each not in used:
                seen[each.second] *= likelihood(each, before)
                seen[each.second] /= seen[each.second].max()
            before = each
        used.update(told)
    forward = np.empty_like(seen)
    belief = known.occupied
    for second in range(seconds):
        belief = (belief @ known.moves if second else belief) * seen[second]
        forward[second] = belief = belief / belief.sum()
    back = np.ones(len(CENTRES))
    found = np.empty((seconds, 3))
    one_hot = np.eye(6)[_CELL_ROOMS]
    for second in reversed(range(seconds)):
        both = forward[second] * back
        both /= both.sum()
        found[second] = (*(both @ CENTRES), int((both @ one_hot).argmax()))
        back = known.moves @ (back * seen[second])
        back /= back.max()
    return found


def hold(told: Sequence[Told], seconds: int, known: Habits) -> Floats:
    """The same as a program reads it: what was said last, before the first message the habit."""
    found = np.empty((seconds, 3))
    found[:] = (*known.mean, known.room)
    for each in told:
        found[each.second :] = (each.x, each.y, int(room_of(each.x, each.y)))
    return found


def scored(found: Floats, truth: Floats) -> tuple[float, float]:
    """The root of the mean square error in metres, and the share of right rooms."""
    error = np.sqrt(((found[:, :2] - truth) ** 2).sum(axis=1).mean())
    right = found[:, 2] == room_of(truth[:, 0], truth[:, 1])
    return round(float(error), 3), round(float(right.mean()), 3)
