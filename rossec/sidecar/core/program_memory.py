"""Where programs behind a sidecar remember: as many places as programs live at a time.

Pure. A program has a place of its own, also if others publish the same topic: values of theirs in
between would set its hysteresis anew. But there is no place for each name, since `rostopic pub`
and `rosbag play` have a new one in each run: who comes goes on where one that is gone has stopped,
best where it has stopped itself. Whether a program is gone is never in the hand of a subscriber.
"""

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from grants.memory import MemoryScope

HolderT = TypeVar("HolderT", bound=Hashable)


@dataclass(eq=False)
class _ProgramMemory(Generic[HolderT]):
    """Who has it, under which name; the name stays when nobody has it any more."""

    name: str
    holders: set[HolderT] = field(default_factory=set)


class ProgramMemories(Generic[HolderT]):
    """Those of one identity.

    Args:
        recall: what the identity remembers.
        gone: whether a holder, that has not left, has ended.
    """

    def __init__(
        self, recall: MemoryScope, gone: Callable[[HolderT], bool] = lambda _: False
    ) -> None:
        self._recall = recall
        self._gone = gone
        self._places: list[_ProgramMemory[HolderT]] = []

    def take(self, name: str, holder: HolderT) -> MemoryScope:
        """What `holder`, a program by that name, has let each key use up."""
        place = self._held_by(holder) or self._named(name) or self._freed() or self._new()
        self._let_go(place)
        if not place.holders:
            place.name = name
        place.holders.add(holder)
        return self._recall.child(str(self._places.index(place)))

    def leave(self, holder: HolderT) -> None:
        """`holder` has ended."""
        for place in self._places:
            place.holders.discard(holder)

    def _held_by(self, holder: HolderT) -> _ProgramMemory[HolderT] | None:
        return next((place for place in self._places if holder in place.holders), None)

    def _named(self, name: str) -> _ProgramMemory[HolderT] | None:
        return next((place for place in self._places if place.name == name), None)

    def _freed(self) -> _ProgramMemory[HolderT] | None:
        for place in self._places:
            self._let_go(place)
            if not place.holders:
                return place
        return None

    def _let_go(self, place: _ProgramMemory[HolderT]) -> None:
        place.holders = {holder for holder in place.holders if not self._gone(holder)}

    def _new(self) -> _ProgramMemory[HolderT]:
        self._places.append(_ProgramMemory(""))
        return self._places[-1]
