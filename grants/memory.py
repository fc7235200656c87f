"""State of rights that are limited over time: rates, slots and hysteresis. Pure.

It belongs to a key, a right and a name, never to a connection: a peer that reconnects, or opens a
hundred connections, continues with the same state; hysteresis is common to all keys
(`grants.common_state`). For a chain the key is its first holder's: who
hands a right on, to however many, gets no more by it. A message counts once: under one message id
it is admitted on every connection of the key. `MemoryStore` keeps the state of one process and is
bounded: only state that equals fresh state and is not in use is evicted, so eviction gains a peer
nothing; otherwise a new peer is refused.
"""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final, TypeAlias
from weakref import WeakValueDictionary

from grants.common_state import CommonState, Group
from grants.decision import Decision
from grants.errors import MemoryExhausted
from grants.limits import RateBucket, SlotGate
from grants.model import Right

MAX_MEMORIES: Final = 16_384  # about 700 bytes each
_MAX_RATES: Final = 64  # of one memory, and as many slots; a grant has one

MakeLock: TypeAlias = Callable[[], AbstractContextManager[Any]]
_CommonKey: TypeAlias = tuple[tuple[str, ...], Right, Group]
_MemoryKey: TypeAlias = tuple[tuple[str, ...], bytes, Right, str]


class Memory:
    """The state of one key, one right and one name.

    Args:
        lock: held around `take` and the use of any other state; one thread needs none.
        find_common: finds what is common to the keys of a group.
    """

    def __init__(
        self,
        lock: AbstractContextManager[Any] | None = None,
        find_common: Callable[[Group], CommonState] | None = None,
    ) -> None:
        self._find_common = find_common or (lambda _: CommonState())
        self.lock: Final = nullcontext() if lock is None else lock
        self._buckets: dict[float, RateBucket] = {}
        self._gates: dict[int, SlotGate] = {}
        self._commons: dict[Group, CommonState] = {}

    def bucket(self, rate: float) -> RateBucket:
        """The bucket for a rate; a new one starts with no more tokens than the others have.

        Raises:
            MemoryExhausted: there are too many.
        """
        with self.lock:
            if rate not in self._buckets:
                _check_limit(len(self._buckets), _MAX_RATES, "rates")
                left = max((other.tokens for other in self._buckets.values()), default=rate + 1)
                self._buckets[rate] = RateBucket(rate, left)
            return self._buckets[rate]

    def gate(self, seconds: int) -> SlotGate:
        """The gate for slots of so many seconds.

        Raises:
            MemoryExhausted: there are too many.
        """
        with self.lock:
            if seconds not in self._gates:
                _check_limit(len(self._gates), _MAX_RATES, "slots")
                self._gates[seconds] = SlotGate(seconds)
            return self._gates[seconds]

    def is_longest(self, gate: SlotGate, now: float) -> bool:
        """Whether no longer slot of the key is in use.

        The moments of slots of many lengths together tell more than those of the longest, and who
        narrows a right can make as many as it likes.
        """
        longer = (each for seconds, each in self._gates.items() if seconds > gate.seconds)
        return not any(each.is_in_use(now) for each in longer)

    def common(self, group: Group) -> CommonState:
        """What is common to a group; without a store, to this key alone.

        Raises:
            MemoryExhausted: there are too many.
        """
        with self.lock:
            if group not in self._commons:
                _check_limit(len(self._commons), _MAX_RATES, "bodies")
                self._commons[group] = self._find_common(group)
            return self._commons[group]

    def take(self, bucket: RateBucket, message_id: object, now: float) -> bool:
        """Whether the message with this id is admitted at `now`; all rates of the key count it.

        So two grants with rates, presented on two connections, admit no more messages than the
        higher of the two alone.
        """
        if bucket.last_message is message_id:
            return True
        for each in self._buckets.values():
            each.refill(now)
        if bucket.left < bucket.interval:
            return False
        for each in self._buckets.values():
            each.charge(message_id)
        return True

    def is_fresh(self, now: float) -> bool:
        """Whether it equals a new memory."""
        with self.lock:
            full = all(each.is_full(now) for each in self._buckets.values())
            unused = all(each.is_fresh(now) for each in self._gates.values())
            return full and unused


class MemoryStore:
    """All memories of one process.

    Args:
        clock: the present time, seconds since the epoch, as the guards are given it.
        lock: makes the locks, if threads share the store.
        limit: the maximum number of memories.
    """

    def __init__(
        self, clock: Callable[[], float], lock: MakeLock = nullcontext, limit: int = MAX_MEMORIES
    ) -> None:
        self._clock = clock
        self._make_lock = lock
        self._limit = limit
        self._lock = lock()
        self._stored: dict[_MemoryKey, Memory] = {}
        self._in_use: WeakValueDictionary[_MemoryKey, Memory] = WeakValueDictionary()
        self._commons: dict[_CommonKey, CommonState] = {}
        self._evicted_at = -1

    def find(self, scope: tuple[str, ...], decision: Decision) -> Memory:
        """The memory for the key, right and name of `decision` within `scope`.

        Raises:
            MemoryExhausted: there are too many, and none can be evicted.
        """
        key = (scope, _first_holder(decision), decision.right, decision.name)
        with self._lock:
            found = self._stored.get(key)
            if found is None:
                self._evict_fresh()
                common = partial(self._common, scope, decision.right)
                found = self._stored[key] = self._in_use[key] = Memory(self._make_lock(), common)
            return found

    def _common(self, scope: tuple[str, ...], right: Right, group: Group) -> CommonState:
        key = scope, right, group
        with self._lock:
            found = self._commons.get(key)
            if found is None:
                if len(self._commons) >= self._limit:
                    unused = [each for each, item in self._commons.items() if item.is_fresh]
                    for each in unused:
                        del self._commons[each]
                _check_limit(len(self._commons), self._limit, "topics with hysteresis")
                found = self._commons[key] = CommonState(self._make_lock())
            return found

    def _evict_fresh(self) -> None:
        now = self._clock()
        if len(self._stored) >= self._limit and int(now) != self._evicted_at:
            self._evicted_at = int(now)
            for key in [key for key, item in self._stored.items() if item.is_fresh(now)]:
                del self._stored[key]
            # Memories that connections still use must stay stored: they will change again.
            self._stored.update(self._in_use.items())
        _check_limit(len(self._stored), self._limit, "limited rights")

    def __len__(self) -> int:
        return len(self._stored)


@dataclass(frozen=True)
class MemoryScope:
    """Finds the memory of a decision for one node, and for one part of its state."""

    store: MemoryStore
    scope: tuple[str, ...]

    def __call__(self, decision: Decision) -> Memory:
        """As `MemoryStore.find`."""
        return self.store.find(self.scope, decision)

    def child(self, part: str) -> "MemoryScope":
        """The scope of a part that is counted separately."""
        return replace(self, scope=(*self.scope, part))


def _first_holder(decision: Decision) -> bytes:
    """The key the state belongs to. A chain's comes first, so that a grant of the last holder's own
    beside it opens no other account; of several chains, that of one of them."""
    chains = [grant for grant in decision.grants if grant.chain]
    return min(grant.links[0].holder for grant in chains or decision.grants)


def _check_limit(count: int, limit: int, what: str) -> None:
    if count >= limit:
        raise MemoryExhausted(
            f"{limit} {what} are stored already, and none can be evicted yet",
            "wait until the rates of other peers have recovered, or restart this node",
        )
