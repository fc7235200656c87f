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
        self, recall: MemoryScope, has_ended: Callable[[HolderT], bool] = lambda _: False
    ) -> None:
        self._recall = recall
        self._has_ended = has_ended
        self._memories: list[_ProgramMemory[HolderT]] = []

    def acquire(self, name: str, holder: HolderT) -> MemoryScope:
        """What `holder`, a program by that name, has let each key use up."""
        memory = self._held_by(holder) or self._with_name(name) or self._released() or self._new()
        self._drop_ended(memory)
        if not memory.holders:
            memory.name = name
        memory.holders.add(holder)
        return self._recall.child(str(self._memories.index(memory)))

    def release(self, holder: HolderT) -> None:
        """`holder` has ended."""
        for memory in self._memories:
            memory.holders.discard(holder)

    def _held_by(self, holder: HolderT) -> _ProgramMemory[HolderT] | None:
        return next((memory for memory in self._memories if holder in memory.holders), None)

    def _with_name(self, name: str) -> _ProgramMemory[HolderT] | None:
        return next((memory for memory in self._memories if memory.name == name), None)

    def _released(self) -> _ProgramMemory[HolderT] | None:
        for memory in self._memories:
            self._drop_ended(memory)
            if not memory.holders:
                return memory
        return None

    def _drop_ended(self, memory: _ProgramMemory[HolderT]) -> None:
        memory.holders = {holder for holder in memory.holders if not self._has_ended(holder)}

    def _new(self) -> _ProgramMemory[HolderT]:
        self._memories.append(_ProgramMemory(""))
        return self._memories[-1]
