"""What `rostopic hz` and `rostopic bw` say of the last messages of a topic. Pure."""

import math
from collections import deque
from itertools import pairwise
from typing import Final

_UNITS: Final = ((1_000_000, "MB"), (1000, "KB"), (1, "B"))


class RateWindow:
    """How often messages came: the last `size` of them, or all since the beginning."""

    def __init__(self, size: int | None = None) -> None:
        self._times: deque[float] = deque(maxlen=size)
        self._fresh = False

    def add(self, now: float) -> None:
        """A message came at `now`, in seconds."""
        self._times.append(now)
        self._fresh = True

    def describe(self) -> str:
        """As rostopic says it; without a new message since the last time, that."""
        fresh, self._fresh = self._fresh, False
        if len(self._times) < 2 or not fresh:
            return "no new messages"
        moments = list(self._times)
        gaps = [later - earlier for earlier, later in pairwise(moments)]
        mean = sum(gaps) / len(gaps)
        spread = math.sqrt(sum((gap - mean) ** 2 for gap in gaps) / len(gaps))
        return (
            f"average rate: {1 / mean if mean > 0 else 0:.3f}\n"
            f"\tmin: {min(gaps):.3f}s max: {max(gaps):.3f}s"
            f" std dev: {spread:.5f}s window: {len(moments)}"
        )


class SizeWindow:
    """How many bytes came: the last `size` messages, or all since the beginning."""

    def __init__(self, size: int | None = None) -> None:
        self._messages: deque[tuple[float, int]] = deque(maxlen=size)

    def add(self, now: float, size: int) -> None:
        """A message of `size` bytes came at `now`, in seconds."""
        self._messages.append((now, size))

    def describe(self, now: float) -> str:
        """As rostopic says it; with fewer than two messages nothing can be said."""
        if len(self._messages) < 2:
            return "no new messages"
        sizes = [size for _, size in self._messages]
        passed = max(now - self._messages[0][0], 1e-9)
        rate, total = sum(sizes) / passed, sum(sizes) / len(sizes)
        scale, unit = next((pair for pair in _UNITS if rate >= pair[0]), _UNITS[-1])
        shown = [f"{value / scale:.2f}{unit}" for value in (rate, total, min(sizes), max(sizes))]
        return (
            f"average: {shown[0]}/s\n"
            f"\tmean: {shown[1]} min: {shown[2]} max: {shown[3]} window: {len(sizes)}"
        )
