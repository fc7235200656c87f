"""A flat of six rooms and somebody with habits in it, by a seed: the same for the same numbers.

Whoever lives there stays for minutes at a few places and walks through the forwarded ports at 0.5 m/s; where
it goes, and for how long, is the habit. The origin of the map is nowhere in particular, so that no
wall lies at a border of a grid.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
import numpy.typing as npt

RATE: Final = 10  # positions a second
SPEED: Final = 0.5  # m/s
WALLS_X: Final = (-3.3, 0.9, 4.6, 8.2)
WALLS_Y: Final = (-2.7, 1.4, 5.1)
NAMES: Final = ("kitchen", "living", "bedroom", "bath", "hall", "study")
COLUMNS: Final = len(WALLS_X) - 1
# How often somebody goes there, and how many seconds on average it stays.
_HABITS: Final = ((0.22, 240), (0.28, 420), (0.1, 300), (0.14, 120), (0.16, 40), (0.1, 300))
_PLACES: Final = ((0.3, 0.7), (0.72, 0.35))  # of each room, as parts of its sides


@dataclass(frozen=True)
class Side:
    """The borders of a room."""

    low: tuple[float, float]
    high: tuple[float, float]

    def at(self, across: float, up: float) -> tuple[float, float]:
        """A point by parts of the sides."""
        (x0, y0), (x1, y1) = self.low, self.high
        return x0 + across * (x1 - x0), y0 + up * (y1 - y0)


ROOMS: Final = tuple(Side((x0, y0), (x1, y1)) for y0, y1 in pairwise(WALLS_Y) for x0, x1 in pairwise(WALLS_X))
PLAN: Final = {
    name: f"{room.low[0]} {room.low[1]}, {room.high[0]} {room.high[1]}"
    for name, room in zip(NAMES, ROOMS, strict=True)
}


def room_of(x: npt.ArrayLike, y: npt.ArrayLike) -> npt.NDArray[np.intp]:
    """The number of the room of each point, of the nearest one if it is in none."""
    column = np.clip(np.searchsorted(WALLS_X, x, "right") - 1, 0, COLUMNS - 1)
    row = np.clip(np.searchsorted(WALLS_Y, y, "right") - 1, 0, len(WALLS_Y) - 2)
    return np.asarray(row * COLUMNS + column)


def walk(seed: int, seconds: int) -> npt.NDArray[np.float64]:
    """The positions of so many seconds, `RATE` of each."""
    rng = np.random.default_rng(seed)
    chances = np.array([chance for chance, _ in _HABITS])
    room, here = 1, np.array(ROOMS[1].at(0.5, 0.5))
    parts: list[npt.NDArray[np.float64]] = []
    while sum(map(len, parts)) < seconds * RATE:
        others = np.where(np.arange(len(ROOMS)) == room, 0, chances)
        goal = int(rng.choice(len(ROOMS), p=others / others.sum()))
        place = _PLACES[int(rng.integers(len(_PLACES)))]
        end = np.array(ROOMS[goal].at(*place)) + rng.normal(0, 0.25, 2)
        for stop in (*_forwarded_ports(room, goal), end):
            parts.append(_leg(here, np.array(stop)))
            here = np.array(stop)
        stay = max(1, int(rng.exponential(_HABITS[goal][1]) * RATE))
        parts.append(np.repeat(here[np.newaxis], stay, axis=0))
        room = goal
    return np.concatenate(parts)[: seconds * RATE]


def _leg(start: npt.NDArray[np.float64], stop: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    count = max(1, round(float(np.linalg.norm(stop - start)) / SPEED * RATE))
    return start + np.linspace(0, 1, count, endpoint=False)[:, np.newaxis] * (stop - start)


def _forwarded_ports(room: int, goal: int) -> list[tuple[float, float]]:
    """The forwarded ports on the way: along the row first, then to the other one."""
    found = []
    while room % COLUMNS != goal % COLUMNS:
        step = 1 if goal % COLUMNS > room % COLUMNS else -1
        found.append(ROOMS[room].at(1.0 if step > 0 else 0.0, 0.5))
        room += step
    if room != goal:
        found.append(ROOMS[room].at(0.5, 1.0 if goal > room else 0.0))
    return found
