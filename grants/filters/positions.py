"""The operator `rooms`, on the messages that have a position: x and y, and z or theta.

Such a message is read as one value of two or three numbers, whatever its type is called: which room
it is in depends on all of them. Everything but x and y is cleared.
"""

from dataclasses import replace
from typing import Final

from grants.common_state import HysteresisState
from grants.errors import FilterRefused
from grants.filters.layout import PRIMITIVES, Array, Primitive, Struct, Type
from grants.filters.parameters import Parameters, number
from grants.filters.rooms import read_plan, snap_rows, snapping
from grants.filters.treatments import (
    DESCEND,
    HysteresisBinding,
    Numbers,
    Treatment,
    TreatmentForType,
)

_HYSTERESIS: Final = "hysteresis"  # so no room has this name
_MAX_REACH: Final = 1000  # metres
_POSITIONS: Final = (("x", "y"), ("x", "y", "z"), ("x", "y", "theta"))
_FLOATS: Final = (PRIMITIVES["float32"], PRIMITIVES["float64"])


def rooms(parameters: Parameters) -> TreatmentForType:
    """A position becomes the point of its room; see `grants.filters.rooms`.

    Raises:
        FilterRefused: no plan, or a hysteresis out of range.
    """
    reach = number(parameters, _HYSTERESIS) if _HYSTERESIS in parameters else None
    if reach is not None and not 0 < reach <= _MAX_REACH:
        raise FilterRefused(f"hysteresis of rooms is above zero and at most {_MAX_REACH} m")
    plan = read_plan({name: text for name, text in parameters.items() if name != _HYSTERESIS})
    bind = snapping(plan, reach)
    identity = (*sorted(parameters.items()),)

    def treat(kind: Type) -> Treatment:
        if isinstance(kind, Array):
            return DESCEND
        position = _as_one_value(kind)
        snap = bind(HysteresisState())
        found = Numbers(snap, snap_rows(snap, len(position.code)), kind=position)
        return (
            found if reach is None else replace(found, hysteresis=HysteresisBinding(identity, bind))
        )

    return treat


def _as_one_value(kind: Type) -> Primitive:
    """A message with a position, as one value of several numbers."""
    if isinstance(kind, Struct) and tuple(name for name, _ in kind.fields) in _POSITIONS:
        for float_type in _FLOATS:
            if all(member is float_type for _, member in kind.fields):
                count = len(kind.fields)
                return Primitive(kind.name, float_type.code * count, float_type.size * count)
    raise FilterRefused(
        f"rooms needs a message of x, y and maybe z or theta, not {kind.name}",
        "for example pose.position of a geometry_msgs/PoseStamped",
    )
