"""What a latching publisher shows somebody who connects: the newest message, if the rate allows it.

Pure. Else the last one that the same key was let see, which tells it nothing. So a program that is
restarted finds what it had, and one that connects again and again never sees more than by staying.
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
    """A serialized message; its mark is what guards know it by."""

    data: Data
    mark: object = field(default_factory=object)


class Latch(Generic[Data]):
    """Of one topic.

    Attributes:
        newest: the message that was published last.
    """

    def __init__(self) -> None:
        self.newest: Sample[Data] | None = None
        self._seen: WeakKeyDictionary[Memory, Sample[Data]] = WeakKeyDictionary()

    def record(self, guard: Guard, sample: Sample[Data]) -> None:
        """`guard` has let it through."""
        if guard.memory is not None:
            self._seen[guard.memory] = sample

    def candidates(self, guard: Guard) -> Iterator[Sample[Data]]:
        """What to try, in this order, until `guard` lets one through."""
        if self.newest is not None:
            yield self.newest
        if guard.memory is not None and guard.memory in self._seen:
            yield self._seen[guard.memory]
