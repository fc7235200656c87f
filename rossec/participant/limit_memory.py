"""What limited rights have used up, for the life of this process: one store for all of its nodes.

A node that is closed and begun again, a topic that is unregistered and published again, a peer that
hangs up and comes back: none of them begins afresh.
"""

from threading import Lock
from typing import Final

from grants.memory import MemoryScope, MemoryStore
from rossec import clock

_MEMORIES: Final = MemoryStore(clock.now, Lock)


def recall(node: str) -> MemoryScope:
    """What the node of that name has let each key use up."""
    return MemoryScope(_MEMORIES, (node,))
