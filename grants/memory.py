"""State of rights that are limited over time: rates and hysteresis. Pure.

It belongs to a key, a right and a name, never to a connection: a peer that reconnects, or opens a
hundred connections, continues with the same state. A message counts once: under one message id it
is admitted on every connection of the key. `MemoryStore` keeps the state of one process and is
bounded: only state that equals fresh state and is not in use is evicted, so eviction gains a peer
nothing; otherwise a new peer is refused.
"""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from typing import Any, Final, TypeAlias
from weakref import WeakValueDictionary

from grants.decision import Decision
from grants.errors import MemoryExhausted
from grants.model import Right

MOST: Final = 16_384  # memories: some 700 bytes each
_MOST_RATES: Final = 64  # of one memory; a grant has one
_MOST_CELLS: Final = 4096  # of one memory: as many fields as a definition may have

CellName: TypeAlias = tuple[object, ...]  # where the field is, and how it is rounded
MakeLock: TypeAlias = Callable[[], AbstractContextManager[Any]]
_Name: TypeAlias = tuple[tuple[str, ...], bytes, Right, str]


class Cell:
    """What a field with hysteresis was last rounded to."""

    __slots__ = ("held",)

    def __init__(self) -> None:
        self.held: float | None = None


class RateBucket:
    """A token bucket: over any time, `rate` messages a second and `max(1, rate)` more at most."""

    def __init__(self, rate: float, tokens: float) -> None:
        self.most: Final = max(1.0, rate)
        self.tokens = min(tokens, self.most)
        self.passed: object = None
        self._rate = rate
        self._at: int | None = None

    def refill(self, now: int) -> None:
        """What came in since the last look; a clock set back brings nothing."""
        if self._at is not None and now > self._at:
            self.tokens = min(self.tokens + (now - self._at) * self._rate, self.most)
        self._at = now

    def charge(self, mark: object) -> None:
        """A message was let through, by this rate or by another of the same key."""
        if self.tokens >= 1:
            self.passed = mark
        self.tokens = max(self.tokens - 1, 0.0)


class Memory:
    """Of one key, one right and one name.

    Args:
        lock: to be held around `take`, `ready` and the use of a cell; one thread needs none.
    """

    def __init__(self, lock: AbstractContextManager[Any] | None = None) -> None:
        self.lock: Final = nullcontext() if lock is None else lock
        self._buckets: dict[float, RateBucket] = {}
        self._cells: dict[CellName, Cell] = {}

    def bucket(self, rate: float) -> RateBucket:
        """The bucket for a rate; a further one begins with no more than the others have left.

        Raises:
            MemoryExhausted: there are too many.
        """
        with self.lock:
            if rate not in self._buckets:
                _check_room(len(self._buckets), _MOST_RATES, "rates")
                left = max((other.tokens for other in self._buckets.values()), default=rate + 1)
                self._buckets[rate] = RateBucket(rate, left)
            return self._buckets[rate]

    def cell(self, name: CellName) -> Cell:
        """The cell of a field.

        Raises:
            MemoryExhausted: there are too many.
        """
        with self.lock:
            if name not in self._cells:
                _check_room(len(self._cells), _MOST_CELLS, "fields with hysteresis")
                self._cells[name] = Cell()
            return self._cells[name]

    def take(self, bucket: RateBucket, mark: object, now: int) -> bool:
        """Whether the message with this mark may pass at `now`; all rates of the key count it.

        So two grants with rates, shown on two connections, let through no more messages than the
        wider of them alone.
        """
        if bucket.passed is mark:
            return True
        for each in self._buckets.values():
            each.refill(now)
        if bucket.tokens < 1:
            return False
        for each in self._buckets.values():
            each.charge(mark)
        return True

    def ready(self, bucket: RateBucket, now: int) -> bool:
        """Whether a new message may pass at `now`."""
        bucket.refill(now)
        return bucket.tokens >= 1

    def recovered(self, now: int) -> bool:
        """Whether a new one would do no other: a value that a cell holds is for good."""
        with self.lock:
            for each in self._buckets.values():
                each.refill(now)
            full = all(each.tokens >= each.most for each in self._buckets.values())
            return full and all(cell.held is None for cell in self._cells.values())


class MemoryStore:
    """All of one process.

    Args:
        clock: the present time, seconds since the epoch.
        lock: makes the locks, where threads share it.
        most: how many are kept.
    """

    def __init__(
        self, clock: Callable[[], int], lock: MakeLock = nullcontext, most: int = MOST
    ) -> None:
        self._clock = clock
        self._make_lock = lock
        self._most = most
        self._lock = lock()
        self._kept: dict[_Name, Memory] = {}
        self._alive: WeakValueDictionary[_Name, Memory] = WeakValueDictionary()
        self._swept = -1

    def find(self, scope: tuple[str, ...], decision: Decision) -> Memory:
        """The memory of what `decision` was made about; `scope` says whose it is.

        Raises:
            MemoryExhausted: there are too many, and none of them has recovered.
        """
        holders = {grant.holder for grant in decision.grants}
        (holder,) = holders  # `authorize` lets no two keys into one decision
        name = (scope, holder, decision.right, decision.name)
        with self._lock:
            found = self._kept.get(name)
            if found is None:
                self._make_room()
                found = self._kept[name] = self._alive[name] = Memory(self._make_lock())
            return found

    def _make_room(self) -> None:
        now = self._clock()
        if len(self._kept) >= self._most and now != self._swept:
            self._swept = now
            for name in [name for name, item in self._kept.items() if item.recovered(now)]:
                del self._kept[name]
            # What a connection uses has survived that: it will use more up, which must stay.
            self._kept.update(self._alive.items())
        _check_room(len(self._kept), self._most, "limited rights")

    def __len__(self) -> int:
        return len(self._kept)


@dataclass(frozen=True)
class MemoryScope:
    """Finds the memory of a decision: of one node, and of one part of what the node does."""

    memories: MemoryStore
    scope: tuple[str, ...]

    def __call__(self, decision: Decision) -> Memory:
        """As `MemoryStore.find`."""
        return self.memories.find(self.scope, decision)

    def child(self, part: str) -> "MemoryScope":
        """For what must be counted apart from the rest."""
        return replace(self, scope=(*self.scope, part))


def _check_room(count: int, most: int, what: str) -> None:
    if count >= most:
        raise MemoryExhausted(
            f"{most} {what} are remembered already, and none can be forgotten yet",
            "wait until the rates of others have recovered, or restart this node",
        )
