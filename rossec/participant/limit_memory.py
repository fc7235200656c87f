"""The state of limited rights (rates), for the life of this process: one store for all its nodes.

Closing and reopening a node, publishing a topic again, or reconnecting does not reset it.
"""

from threading import Lock
from typing import Final

from grants.memory import MemoryScope, MemoryStore
from rossec import clock

_MEMORIES: Final = MemoryStore(clock.time, Lock)


def memory_scope(node: str) -> MemoryScope:
    """What each key has used up at the node of that name."""
    return MemoryScope(_MEMORIES, (node,))
