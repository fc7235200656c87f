"""Hysteresis that is common to all holders of a right, and to all topics of one body. Pure.

Two receivers with a hysteresis each, or one receiver of two topics, get two samples of one
position, and the cells of both together are smaller than one. So a value is held for all alike:
for all holders of a topic, and with a `body` in the restrictions for all topics of a publisher that
show the same thing. There the state of a coordinate is kept for each frame, by the name of the
field, and one frame is told at a time: cells of two frames are shifted and intersect.
"""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from itertools import takewhile
from typing import Any, Final, TypeAlias

from grants.decision import Decision
from grants.errors import MemoryExhausted, RestrictionMismatch

FieldKey: TypeAlias = tuple[object, ...]  # path of the field, and how it is rounded
Group: TypeAlias = tuple[bool, str]  # whether it is a body, and which, or which topic

_MAX_FIELDS: Final = 4096  # as many as a definition may have
_HEADER: Final = 12  # seq and stamp, before the length of frame_id


class HysteresisState:
    """The value a field with hysteresis was last rounded to."""

    __slots__ = ("value",)

    def __init__(self) -> None:
        self.value: float | None = None


class CommonState:
    """The hysteresis of one group.

    Args:
        lock: held while a message is filtered; one thread needs none.
    """

    def __init__(self, lock: AbstractContextManager[Any] | None = None) -> None:
        self.lock: Final = nullcontext() if lock is None else lock
        self._states: dict[FieldKey, HysteresisState] = {}
        self._frame: bytes | None = None
        self._until = 0.0

    def hysteresis(self, field: FieldKey) -> HysteresisState:
        """The state of a field.

        Raises:
            MemoryExhausted: there are too many.
        """
        found = self._states.get(field)
        if found is None:
            if len(self._states) >= _MAX_FIELDS:
                raise MemoryExhausted(
                    f"{_MAX_FIELDS} fields with hysteresis are stored already",
                    "restart this node",
                )
            found = self._states[field] = HysteresisState()
        return found

    def leads(self, frame: bytes, now: float, slot: int) -> bool:
        """Whether messages of `frame` are told now: that which was told first, while it comes."""
        if frame != self._frame and now < self._until:
            return False
        self._frame, self._until = frame, now + 2 * slot
        return True

    @property
    def is_fresh(self) -> bool:
        """Whether it equals a new one; a value never expires."""
        return self._frame is None and all(one.value is None for one in self._states.values())


class BodyFields:
    """The fields of one guard whose hysteresis is that of a body, frame by frame."""

    def __init__(self, common: CommonState) -> None:
        self._common = common
        self._bound: dict[FieldKey, HysteresisState] = {}

    def bind(self, field: FieldKey) -> HysteresisState:
        """The state that the filter of a field uses.

        It is found by the field's own name: `x` of a pose and of an odometry are the same. A second
        one of that name in a message is another point.
        """
        names = list(takewhile(lambda part: isinstance(part, str), field[1:]))
        how = field[1 + len(names) :]
        name = "" if "/" in str(names[-1]) else names[-2]  # a whole position is told by its plan
        key = (field[0], name, *how)
        return self._bound.setdefault(field if key in self._bound else key, HysteresisState())

    def load(self, frame: bytes) -> None:
        """Use the values of `frame`."""
        for key, state in self._bound.items():
            state.value = self._common.hysteresis((frame, *key)).value

    def store(self, frame: bytes) -> None:
        """Keep the values for `frame`."""
        for key, state in self._bound.items():
            self._common.hysteresis((frame, *key)).value = state.value


def group_of(decision: Decision) -> Group:
    """What the hysteresis of a decision is common to.

    Raises:
        RestrictionMismatch: its restrictions name two bodies.
    """
    bodies = {each.body for each in decision.restrictions if each.body is not None}
    if len(bodies) > 1:
        raise RestrictionMismatch(
            f"the grants for {decision.name} name {len(bodies)} bodies: "
            + ", ".join(sorted(bodies)),
            "what is one body has one name in the policy",
        )
    return (True, bodies.pop()) if bodies else (False, decision.name)


def frame_reader(*, has_header: bool) -> Callable[[Any], bytes]:
    """A function that reads the frame of a message; empty if its type begins with no header."""

    def frame(message: Any) -> bytes:
        end = _HEADER + 4
        size = int.from_bytes(message[_HEADER:end], "little")
        return bytes(message[end : end + size])

    return frame if has_header else lambda _: b""
