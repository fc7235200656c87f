"""Memory of limits per program behind a sidecar: one for each program that runs at a time.

Pure. Each program has its own memory, also if others publish the same topic: their values would
reset its hysteresis. There is no memory per name, since `rostopic pub` and `rosbag play` use a
new name in each run: a new program reuses the memory of one that has ended, preferably of the same
name. A subscriber cannot influence whether a program counts as ended.
"""

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from grants.memory import MemoryScope

HolderT = TypeVar("HolderT", bound=Hashable)


@dataclass(eq=False)
class _ProgramMemory(Generic[HolderT]):
    """The holders of a memory and their name; the name stays when there is no holder."""

    name: str
    holders: set[HolderT] = field(default_factory=set)


class ProgramMemories(Generic[HolderT]):
    """The memories of one identity.

    Args:
        scope: the memory scope of the identity.
        has_ended: whether a holder that was not released has ended.
    """

    def __init__(
        self, scope: MemoryScope, has_ended: Callable[[HolderT], bool] = lambda _: False
    ) -> None:
        self._scope = scope
        self._has_ended = has_ended
        self._memories: list[_ProgramMemory[HolderT]] = []

    def acquire(self, name: str, holder: HolderT) -> MemoryScope:
        """The memory scope of `holder`, a program of this name."""
        memory = self._held_by(holder) or self._with_name(name) or self._released() or self._new()
        self._drop_ended(memory)
        if not memory.holders:
            memory.name = name
        memory.holders.add(holder)
        return self._scope.child(str(self._memories.index(memory)))

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
