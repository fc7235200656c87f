"""What each operator lets through of one value: nothing, steps, a range, or all of it. Pure.

By the operators' algebra, for the whole range of a type and not for values that were tried. A
number goes through functions that never decrease, so what lies between two values lies between
what becomes of them; NaN and infinities pass `round`, and `clamp` makes NaN its lower end. A cell
that the type's range cuts off, as that of 0 of an unsigned number, counts as a whole one.
"""

from collections.abc import Callable, Iterable, Mapping
from enum import Enum
from itertools import pairwise
from typing import Final, NamedTuple

from grants.errors import FilterRefused
from grants.filters.layout import Primitive, Text
from grants.filters.rooms import Room, read_plan
from grants.model import FilterRule, Scalar

Kind = Primitive | Text
_Parameters = Mapping[str, Scalar]
_WHOLE: Final = 1e-9  # how far from a whole number the ratio of two steps may be
_EXACT_UNIT: Final = 1 << 20  # multiples of its inverse, up to 2^32, are exact in 64 bits
_ROOM_FIELDS: Final = ("x", "y")


class Through(Enum):
    """How much of a value comes through one operator."""

    NOTHING = "the same whatever is sent"
    STEPS = "one value for each interval of at least a size"
    RANGE = "as it is within a range, which it never leaves"
    TOLD = "another value, that tells which are the same"
    ALL = "as it is"


class Passing(NamedTuple):
    """`size` is that of STEPS; `is_joint`: of cells of several fields together."""

    through: Through
    size: float = 0.0
    is_joint: bool = False


def passing(rule: FilterRule, kind: Kind, path: str) -> Passing:
    """What `rule` lets through of the value at `path`, of type `kind`, which it covers.

    Raises:
        FilterRefused: it depends on other fields of the message, so nothing can be said.
    """
    return _OPERATORS[rule.operator](dict(rule.parameters), kind, path)


def _nothing(_: _Parameters, _kind: Kind, _path: str) -> Passing:
    return Passing(Through.NOTHING)


def _round(parameters: _Parameters, kind: Kind, _path: str) -> Passing:
    step = float(parameters["step"])
    is_integer = isinstance(kind, Primitive) and len(kind.code) == 1 and kind.code not in "fd"
    return Passing(Through.ALL) if is_integer and step == 1 else Passing(Through.STEPS, step)


def _clamp(parameters: _Parameters, kind: Kind, _path: str) -> Passing:
    low, high = parameters["low"], parameters["high"]
    if isinstance(kind, Primitive) and kind.code in "bBhHiIqQ":
        bits = 8 * kind.size
        least = 0 if kind.code.isupper() else -(1 << bits - 1)
        if (low, high) == (least, least + (1 << bits) - 1):
            return Passing(Through.ALL)
    return Passing(Through.NOTHING if low == high != 0 else Through.RANGE)


def _truncate(parameters: _Parameters, _kind: Kind, _path: str) -> Passing:
    return Passing(Through.NOTHING if parameters["length"] == 0 else Through.TOLD)


def _hash(_: _Parameters, _kind: Kind, _path: str) -> Passing:
    return Passing(Through.TOLD)


def _pixelate(_: _Parameters, _kind: Kind, path: str) -> Passing:
    raise FilterRefused(
        f"what is seen of {path} depends on other fields of the picture", "ask for its level"
    )


def _rooms(parameters: _Parameters, _kind: Kind, path: str) -> Passing:
    """A room is known by x and y together; the rest is cleared."""
    name = path.rpartition(".")[2]
    if name not in _ROOM_FIELDS:
        return Passing(Through.TOLD)  # zero in a room, NaN outside
    plan = read_plan({name: text for name, text in parameters.items() if name != "hysteresis"})
    return Passing(
        Through.STEPS, min(_inner(room, _ROOM_FIELDS.index(name)) for room in plan), True
    )


def _inner(room: Room, axis: int) -> float:
    """Metres of the shortest line through the room that is known by its point: none of a corner.

    Of a rectangle along the axes its side; of another polygon a line through a corner is as short
    as one likes.
    """
    is_rectangle = len(room.corners) == 4 and all(
        (x0 == x1) != (y0 == y1) for (x0, y0), (x1, y1) in room.edges
    )
    sides = [corner[axis] for corner in room.corners]
    return max(sides) - min(sides) if is_rectangle else 0.0


def _all(_: _Parameters, _kind: Kind, _path: str) -> Passing:
    return Passing(Through.ALL)


_OPERATORS: Final[Mapping[str, Callable[[_Parameters, Kind, str], Passing]]] = {
    "clear": _nothing,
    "set": _nothing,
    "redact": _nothing,
    "drop": _nothing,
    "zero": _nothing,
    "round": _round,
    "clamp": _clamp,
    "truncate": _truncate,
    "hash": _hash,
    "pixelate": _pixelate,
    "rooms": _rooms,
    "sort": _all,  # which element is which is hidden, but no value
}


def size_of(passed: Iterable[Passing]) -> float:
    """The least size of what stands for one value after all of these, in whichever order; 0: none.

    Applied one after another, steps divide each other's intervals unless each is a whole multiple
    of the one before: then the largest remains, else only the smallest is certain.
    """
    found = (each for each in passed if each.through is Through.STEPS)
    steps = sorted(found, key=lambda each: each.size)
    if not steps:
        return 0.0
    nested = all(_is_multiple(small, large) for small, large in pairwise(steps))
    return max(each.size for each in steps) if nested else min(each.size for each in steps)


def _is_multiple(small: Passing, large: Passing) -> bool:
    """Whether every border of the large cells is one of the small: even ratios need exact sums."""
    if small.size == large.size and not (small.is_joint or large.is_joint):
        return True
    if small.is_joint or large.is_joint or not small.size:
        return False
    ratio = large.size / small.size
    is_exact = all(float(each.size * _EXACT_UNIT).is_integer() for each in (small, large))
    return abs(ratio - round(ratio)) < _WHOLE and (round(ratio) % 2 == 1 or is_exact)
