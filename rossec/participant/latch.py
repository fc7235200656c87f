"""What a latching publisher sends to a new subscriber: the newest message, if the rate allows it.

Pure. Otherwise the last one that was sent to the same key, which reveals nothing new. A restarted
program receives what it had; reconnecting again and again reveals no more than staying connected.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Generic, TypeVar
from weakref import WeakKeyDictionary

from grants.guard import Guard
from grants.memory import Memory

Data = TypeVar("Data", bytes, memoryview)


@dataclass(frozen=True)
class Sample(Generic[Data]):
    """A serialized message; guards identify it by its mark."""

    data: Data
    mark: object = field(default_factory=object)


class Latch(Generic[Data]):
    """The latched messages of one topic.

    Attributes:
        newest: the last message published.
    """

    def __init__(self) -> None:
        self.newest: Sample[Data] | None = None
        self._seen: WeakKeyDictionary[Memory, Sample[Data]] = WeakKeyDictionary()

    def record(self, guard: Guard, sample: Sample[Data]) -> None:
        """Note that `guard` has let `sample` through."""
        if guard.memory is not None:
            self._seen[guard.memory] = sample

    def candidates(self, guard: Guard) -> Iterator[Sample[Data]]:
        """The messages to try, in this order, until `guard` lets one through."""
        if self.newest is not None:
            yield self.newest
        if guard.memory is not None and guard.memory in self._seen:
            yield self._seen[guard.memory]
