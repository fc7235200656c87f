"""A bounded table whose room is shared by those who fill it. Pure.

Where it is full, whoever has most makes room, with the oldest that is theirs; of those with the
lowest rank first, and never of a higher rank than the newcomer's. So a table that ends its oldest
entry cannot be used to end another's, and what a stranger begins ends nothing that an owner began.
"""

from collections import Counter
from typing import Generic, NamedTuple, TypeVar

K = TypeVar("K")
V = TypeVar("V")


class _Entry(NamedTuple, Generic[V]):
    value: V
    owner: str
    rank: int


class SharedTable(Generic[K, V]):
    """At most `limit` values by their keys, each of an owner."""

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._entries: dict[K, _Entry[V]] = {}  # oldest first

    def __repr__(self) -> str:
        return f"SharedTable({self._entries!r})"

    def __len__(self) -> int:
        return len(self._entries)

    def add(self, key: K, value: V, owner: str, rank: int = 0) -> list[V] | None:
        """Put a value in; returns those that made room. None: there is no room for `owner`."""
        self._entries.pop(key, None)
        ended: list[V] = []
        while len(self._entries) >= self._limit:
            victim = self._victim(owner, rank)
            if victim is None:
                return None
            ended.append(self._entries.pop(victim).value)
        self._entries[key] = _Entry(value, owner, rank)
        return ended

    def get(self, key: K) -> V | None:
        """The value of a key; None: there is none."""
        found = self._entries.get(key)
        return None if found is None else found.value

    def pop(self, key: K) -> V | None:
        """The same, and it is taken out."""
        found = self._entries.pop(key, None)
        return None if found is None else found.value

    def owner(self, key: K) -> tuple[str, int] | None:
        """Owner and rank of what a key has; None: there is nothing."""
        found = self._entries.get(key)
        return None if found is None else (found.owner, found.rank)

    def items(self) -> list[tuple[K, V]]:
        """All of it, oldest first."""
        return [(key, entry.value) for key, entry in self._entries.items()]

    def _victim(self, owner: str, rank: int) -> K | None:
        lowest = min(entry.rank for entry in self._entries.values())
        if lowest > rank:
            return None
        of_rank = [entry.owner for entry in self._entries.values() if entry.rank == lowest]
        counts = Counter(of_rank)
        most = max(counts, key=counts.__getitem__)
        if lowest == rank and counts[most] <= counts[owner] + 1:
            most = owner  # who has a share like everybody's makes room for themselves
        return next(
            (
                key
                for key, entry in self._entries.items()
                if entry.owner == most and entry.rank == lowest
            ),
            None,
        )
