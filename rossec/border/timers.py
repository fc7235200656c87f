"""One list of what is due for all things of a border router: none has a task of its own. Pure."""

import heapq
from collections.abc import Callable
from itertools import count
from typing import Final

_SLACK: Final = 256


class Timers:
    """Calls that are due at a time; the clock is the caller's."""

    def __init__(self) -> None:
        self._heap: list[tuple[float, int]] = []
        self._calls: dict[int, Callable[[float], None]] = {}
        self._numbers = count()

    def __len__(self) -> int:
        return len(self._calls)

    @property
    def next_due(self) -> float | None:
        """When `run` has something to do next; None: never."""
        while self._heap and self._heap[0][1] not in self._calls:
            heapq.heappop(self._heap)
        return self._heap[0][0] if self._heap else None

    def at(self, due: float, call: Callable[[float], None]) -> int:
        """Call `call(now)` at `due`; returns what cancels it."""
        number = next(self._numbers)
        self._calls[number] = call
        heapq.heappush(self._heap, (due, number))
        return number

    def cancel(self, number: int) -> None:
        """Do not make this call; one that was made, or cancelled, is ignored."""
        self._calls.pop(number, None)
        if len(self._heap) > _SLACK + 2 * len(self._calls):  # most of what waits was cancelled
            self._heap = [entry for entry in self._heap if entry[1] in self._calls]
            heapq.heapify(self._heap)

    def run(self, now: float) -> None:
        """Make every call that is due."""
        while (due := self.next_due) is not None and due <= now:
            _, number = heapq.heappop(self._heap)
            self._calls.pop(number)(now)
