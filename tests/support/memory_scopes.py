"""New memory scopes of limited rights."""

from types import SimpleNamespace
from typing import Any, Final

from grants.guard import MemoryScope, MemoryStore

HOLDER: Final[Any] = SimpleNamespace(holder=bytes(32), chain=())
HOLDER.links = (HOLDER,)
"""What a decision's memory is found by, in place of a grant."""


def fresh(clock: int = 0) -> MemoryScope:
    """The empty memory of a node."""
    return MemoryScope(MemoryStore(lambda: clock), ("/node",))
