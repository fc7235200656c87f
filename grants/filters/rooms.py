"""Rooms: a position becomes the point of the room it is in, so a receiver learns the room alone.

A plan is a text for each room: the corners of a polygon, or two opposite corners of a rectangle. A
position in no room has no value (NaN): zero, or the nearest room, would name a place where it is
not. With hysteresis a room is kept until the position is that far outside of it, or a position at
a door would tell by the changes exactly where it is. docs/spec/grant.md, section 6.4.
"""

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, TypeAlias

from grants.common_state import HysteresisState
from grants.errors import FilterRefused
from grants.filters.lazy_numpy import Vector, np

Point: TypeAlias = tuple[float, float]
Place: TypeAlias = tuple[float, ...]  # the values of a message with a position

MAX_ROOMS: Final = 64
MAX_CORNERS: Final = 512  # of all rooms
MAX_TEXT: Final = 1000  # characters of one room
_NAME: Final = re.compile(r"[a-z][a-z0-9_-]{0,31}", re.ASCII)
_NUMBER: Final = r"-?(?:0|[1-9][0-9]{0,5})(?:\.[0-9]{1,3})?"
_CORNERS: Final = re.compile(rf"{_NUMBER} {_NUMBER}(?:, ?{_NUMBER} {_NUMBER})+", re.ASCII)
_EXAMPLE: Final = 'for example {rooms: {kitchen: "0 0, 4 3", hall: "4 0, 9 0, 9 6, 4 3"}}'


@dataclass(frozen=True)
class Room:
    """A polygon, by the rule of even crossings, and the point that stands for it."""

    name: str
    corners: tuple[Point, ...]
    point: Point

    @property
    def edges(self) -> Iterable[tuple[Point, Point]]:
        """From each corner to the next."""
        return pairwise((*self.corners, self.corners[0]))

    def covers(self, x: float, y: float) -> bool:
        """Whether the point is in the room; of two rooms with a common wall it is in one."""
        within = False
        for (x0, y0), (x1, y1) in self.edges:
            if (y0 <= y) != (y1 <= y) and x < x0 + (y - y0) * (x1 - x0) / (y1 - y0):
                within = not within
        return within

    def is_within(self, reach: float, x: float, y: float) -> bool:
        """Whether the point is in the room, or at most `reach` from its walls."""
        return self.covers(x, y) or any(_distance(edge, x, y) <= reach for edge in self.edges)


def _distance(edge: tuple[Point, Point], x: float, y: float) -> float:
    (x0, y0), (x1, y1) = edge
    dx, dy = x1 - x0, y1 - y0
    length = dx * dx + dy * dy
    along = min(max(((x - x0) * dx + (y - y0) * dy) / length, 0.0), 1.0) if length else 0.0
    return math.hypot(x - x0 - along * dx, y - y0 - along * dy)


def read_plan(texts: Mapping[str, object]) -> tuple[Room, ...]:
    """The rooms of a plan, in the order of their names.

    Raises:
        FilterRefused: no room, too many rooms or corners, a name or a text of another form, or a
            room without area.
    """
    if not 0 < len(texts) <= MAX_ROOMS:
        raise FilterRefused(f"rooms needs 1 to {MAX_ROOMS} rooms", _EXAMPLE)
    rooms = tuple(_room(name, texts[name]) for name in sorted(texts))
    if sum(len(room.corners) for room in rooms) > MAX_CORNERS:
        raise FilterRefused(f"rooms with more than {MAX_CORNERS} corners", "draw them simpler")
    return rooms


def _room(name: str, text: object) -> Room:
    if _NAME.fullmatch(name) is None:
        raise FilterRefused(f"not the name of a room: {name[:40]!r}", _EXAMPLE)
    if not isinstance(text, str) or len(text) > MAX_TEXT or _CORNERS.fullmatch(text) is None:
        raise FilterRefused(f"room {name} has no corners: {str(text)[:40]!r}", _EXAMPLE)
    corners = tuple(_corner(pair) for pair in text.split(","))
    if len(corners) == 2:  # opposite corners
        (x0, y0), (x1, y1) = corners
        corners = ((x0, y0), (x1, y0), (x1, y1), (x0, y1))
    return Room(name, corners, _middle(name, corners))


def _corner(pair: str) -> Point:
    x, y = pair.split()
    return float(x), float(y)


def _middle(name: str, corners: tuple[Point, ...]) -> Point:
    """A point inside: the middle of the largest piece between two corners' heights."""
    flat = Room(name, corners, (0.0, 0.0))
    best, point = 0.0, (0.0, 0.0)
    for low, high in pairwise(sorted({y for _, y in corners})):
        y = (low + high) / 2
        crossed = sorted(
            x0 + (y - y0) * (x1 - x0) / (y1 - y0)
            for (x0, y0), (x1, y1) in flat.edges
            if (y0 <= y) != (y1 <= y)
        )
        for left, right in zip(crossed[::2], crossed[1::2], strict=True):
            if (right - left) * (high - low) > best:
                best, point = (right - left) * (high - low), ((left + right) / 2, y)
    if best <= 0:
        raise FilterRefused(f"room {name} has no area", _EXAMPLE)
    return point


def snapping(
    rooms: tuple[Room, ...], reach: float | None
) -> Callable[[HysteresisState], Callable[..., Place]]:
    """The function from x, y and the rest of a position to the point of its room.

    With `reach`, the hysteresis, a state holds the number of the room a position was last in.
    """

    def room_of(x: float, y: float) -> int | None:
        return next((number for number, room in enumerate(rooms) if room.covers(x, y)), None)

    def bind(state: HysteresisState) -> Callable[..., Place]:
        def snap(x: float, y: float, *rest: float) -> Place:
            last = state.value
            if reach is None or last is None or not rooms[int(last)].is_within(reach, x, y):
                last = state.value = room_of(x, y)
            if last is None:
                return (math.nan,) * (2 + len(rest))
            return *rooms[int(last)].point, *(0.0 for _ in rest)

        return snap

    return bind


def snap_rows(snap: Callable[..., Place], width: int) -> Callable[[Vector], Vector]:
    """The same for arrays, of `width` values for each position."""

    def vector(values: Vector) -> Vector:
        found = [snap(*row) for row in values.reshape(-1, width).tolist()]
        return np.array(found, values.dtype).reshape(values.shape)

    return vector
