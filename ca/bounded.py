"""Tables that peers fill and that are bounded all the same: the oldest entries make room. Pure.

A table in which one owner's entries must not push out another's is `rossec.peer_limits.SharedTable`.
"""

from collections import OrderedDict
from contextlib import suppress
from typing import Generic, TypeVar

K = TypeVar("K")
V = TypeVar("V")


class Newest(OrderedDict[K, V]):
    """At most `limit` entries: those that were set or used last."""

    # An OrderedDict, since the first key of a dict is found behind all that were deleted before it.

    def __init__(self, limit: int) -> None:
        super().__init__()
        self._limit = limit

    def __setitem__(self, key: K, value: V) -> None:
        super().__setitem__(key, value)
        with suppress(KeyError):  # another thread's entries have pushed it out already
            self.move_to_end(key)
        while len(self) > self._limit:
            self.popitem(last=False)

    def use(self, key: K) -> V | None:
        """The value; its entry is the newest again."""
        try:
            self.move_to_end(key)
            return self[key]
        except KeyError:
            return None


class ExpiringTable(Generic[K, V]):
    """At most `limit` values, each for `lifetime` seconds; `now` is of a clock that cannot be set."""

    def __init__(self, limit: int, lifetime: float) -> None:
        self._entries: Newest[K, tuple[V, float]] = Newest(limit)
        self._lifetime = lifetime

    def put(self, key: K, value: V, now: float) -> None:
        self._entries[key] = value, now + self._lifetime

    def get(self, key: K, now: float) -> V | None:
        value, end = self._entries.get(key, (None, now))
        return value if now < end else None
