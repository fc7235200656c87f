"""A position at the room as the room itself, where the policy says which rooms there are.

A rule that rounds a whole position to the cell of a room becomes the operator `rooms`; any other
stays. Rooms and the cells of an area do not nest, so a position that has rooms has no area.
"""

import math
from typing import Final

from grants.errors import FilterRefused
from grants.filters.layout import Layout, Struct, Type
from grants.filters.operators import treatment_for
from grants.filters.rooms import Room, read_plan
from grants.model import FilterRule, Scalar
from grants.vocabulary.contents import Content
from grants.vocabulary.levels import Treatment, level_of
from grants.vocabulary.words import DataWord

OPERATOR: Final = "rooms"
SMALLEST: Final = 1.0  # square metres; a plan of smaller ones is a grid, not rooms
NARROWEST: Final = 0.8  # metres, of four areas by the circumference; of a long room twice its width
HYSTERESIS: Final = 0.5  # metres outside of a room that still count as in it
_ROOM: Final = level_of(DataWord.POSITION, "room").treatments[Content.COORDINATE]
_AREA: Final = level_of(DataWord.POSITION, "area").treatments[Content.COORDINATE]


def plan_treatment(plan: dict[str, Scalar]) -> Treatment:
    """The operator for a plan: corners by name, as in docs/spec/grant.md, section 6.4.

    Raises:
        FilterRefused: it is not a plan, or a room in it is smaller than one.
    """
    if "hysteresis" in plan:
        raise FilterRefused("no room can be called hysteresis", "call it otherwise")
    found = Treatment(OPERATOR, tuple(sorted({**plan, "hysteresis": HYSTERESIS}.items())))
    treatment_for(FilterRule("position", *found))
    if smallest(found) < SMALLEST:
        raise FilterRefused(f"a room has less than {SMALLEST:g} square metre", "corners in metres")
    if narrowest(found) < NARROWEST:
        hint = "a plan of strips tells where in a room; draw whole rooms"
        raise FilterRefused(f"a room is narrower than {NARROWEST / 2:g} metres", hint)
    return found


def smallest(rooms: Treatment) -> float:
    """Square metres of the smallest room of an operator `rooms`."""
    plan = {name: text for name, text in rooms.parameters if name != "hysteresis"}
    return min(_area(room.corners) for room in read_plan(plan))


def narrowest(rooms: Treatment) -> float:
    """Metres of the narrowest room: four times its area by its circumference, of a square its side.

    A strip of a millimetre has a square metre, too, if it is long enough.
    """
    plan = {name: text for name, text in rooms.parameters if name != "hysteresis"}
    return min(4 * _area(room.corners) / _circumference(room) for room in read_plan(plan))


def _circumference(room: Room) -> float:
    return math.fsum(math.dist(*edge) for edge in room.edges)


def _area(corners: tuple[tuple[float, float], ...]) -> float:
    """By the shoelace formula."""
    pairs = zip(corners, (*corners[1:], corners[0]), strict=True)
    return abs(math.fsum(x0 * y1 - x1 * y0 for (x0, y0), (x1, y1) in pairs)) / 2


def in_rooms(layout: Layout, rule: FilterRule, rooms: Treatment) -> FilterRule:
    """`rule`, or `rooms` in its place if it shows the cell of a room of a whole position.

    Raises:
        FilterRefused: it shows the area of one.
    """
    given = (rule.operator, rule.parameters)
    if given not in (_ROOM, _AREA) or not _is_position(layout.root, rule.path, rooms):
        return rule
    if given == _AREA:
        raise FilterRefused(
            f"{rule.path}: where the policy has rooms, a position has no area", "room, or no"
        )
    return FilterRule(rule.path, *rooms)


def _is_position(kind: Type, path: str, rooms: Treatment) -> bool:
    """Whether the operator can be used for the field at `path`."""
    for name in path.split("."):
        found = dict(kind.fields).get(name) if isinstance(kind, Struct) else None
        if found is None:  # within an array
            return False
        kind = found
    try:
        treatment_for(FilterRule(path, *rooms))(kind)
    except FilterRefused:
        return False
    return isinstance(kind, Struct)
