"""How precisely a receiver sees a field: tried on the compiled filters of a verdict. Pure.

The filters are those the publisher would run. A field is no finer than a step if every value that
is seen stands for an interval of at least that length; it is hidden if it is the same whatever is
sent. Tried along lines through the numbers that the filters themselves name, at other values of the
fields beside it, so the answer is that of a measurement: what it finds too fine is too fine.
"""

import math
import re
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from typing import Final

from grants.decision import Decision
from grants.errors import MessageRefused
from grants.filters.hashing import FILTER_KEY_SIZE
from grants.filters.layout import Layout, Primitive, Text
from grants.guard import Guard, needed_keys
from grants.model import FilterRule
from grants.policy.decision import Verdict
from grants.policy.sample_messages import Value, leaves, read_back, serialize

_FOREVER: Final = 1 << 53
_PACE: Final = 1_000_000  # seconds between two messages: no slot and no hysteresis in time
_SAMPLES: Final = 48
_STEPS: Final = (0.26, 0.171)  # of the length asked for, between two values
_CENTRES: Final = 12
_BISECTIONS: Final = 40
_NUMBER: Final = re.compile(r"-?[0-9]+(?:\.[0-9]+)?", re.ASCII)
_TEXTS: Final = ("", "a", "kitchen", "map")
_BOUNDS: Final = {"b": 7, "B": 8, "h": 15, "H": 16, "i": 31, "I": 32, "q": 53, "Q": 53}


class Sight:
    """What the receiver of a verdict sees of messages of one layout.

    Raises:
        GrantError: the filters do not fit the layout; its methods: they refuse the messages that
            are tried, so nothing is known.
    """

    def __init__(self, layout: Layout, verdict: Verdict) -> None:
        self._layout = layout
        self._leaves = leaves(layout)
        restrictions = tuple(
            replace(
                each, conditions=(), rate=None, slot=None,
                filters=tuple(map(_stateless, each.filters)),
            )
            for each in verdict.restrictions
            if each.filters
        )  # fmt: skip
        self._rules = [rule for each in restrictions for rule in each.filters]
        decision = Decision(verdict.right, verdict.name, (), _FOREVER, restrictions)
        keys = dict.fromkeys(needed_keys(restrictions), bytes(FILTER_KEY_SIZE))
        self._guard = Guard(layout, decision, keys)
        self._now = 0

    def is_hidden(self, path: str) -> bool:
        """Whether the leaf at `path` is the same whatever is sent."""
        return len({self._seen(path, value) for value in self._values(path)}) == 1

    def is_exact(self, path: str) -> bool:
        """Whether the leaf at `path` is seen as it is sent."""
        return all(self._seen(path, value) == _key(value) for value in self._values(path))

    def is_no_finer_than(self, path: str, step: float) -> bool:
        """Whether every value seen at `path`, a leaf of numbers, stands for at least `step`."""
        if self.is_hidden(path):
            return True
        return all(
            self._is_coarse(path, beside, centre, step)
            for beside in (0.0, *self._centres()[:4])
            for centre in (0.0, *self._centres())
        )

    def _values(self, path: str) -> tuple[Value, ...]:
        kind = self._leaves[path]
        if isinstance(kind, Text):
            return _TEXTS
        if kind.name == "bool":
            return (0, 1)
        if kind.code in "fd":
            return (0.0, 0.375, -3.25, 17.5, 1000.25)
        low = kind.code.islower() and len(kind.code) == 1
        return (0, 1, 3, 60, 100, *((-3,) if low else ()))

    def _centres(self) -> tuple[float, ...]:
        """Numbers that the filters name: borders may be there."""
        texts = (str(value) for rule in self._rules for _, value in rule.parameters)
        found = (float(number) for text in texts for number in _NUMBER.findall(text))
        return tuple(dict.fromkeys(found))[:_CENTRES]

    def _is_coarse(self, path: str, beside: float, centre: float, step: float) -> bool:
        return all(
            self._cells_are_wide(path, beside, list(self._line(path, centre, step * part)), step)
            for part in _STEPS
        )

    def _line(self, path: str, centre: float, spacing: float) -> Iterator[float]:
        kind = self._leaves[path]
        assert isinstance(kind, Primitive)  # noqa: S101 - a leaf of numbers
        low, high = _range(kind)
        for number in range(-_SAMPLES // 2, _SAMPLES // 2):
            value = centre + number * spacing
            if low <= value <= high:
                yield value

    def _cells_are_wide(self, path: str, beside: float, line: list[float], step: float) -> bool:
        seen = [self._seen(path, value, beside) for value in line]
        borders: list[float] = []
        for (low, left), (high, right) in pairwise(zip(line, seen, strict=True)):
            if left != right:
                border = self._border(path, beside, low, high)
                if self._seen(path, border[1], beside) != right:
                    return False  # a value between the two, of less than the spacing
                borders.append(border[1])
        return all(b - a >= step * (1 - 1e-6) for a, b in pairwise(borders))

    def _border(self, path: str, beside: float, low: float, high: float) -> tuple[float, float]:
        """Two neighbours between which what is seen changes."""
        left = self._seen(path, low, beside)
        for _ in range(_BISECTIONS):
            middle = (low + high) / 2
            if self._seen(path, middle, beside) == left:
                low = middle
            else:
                high = middle
        return low, high

    def _seen(self, path: str, value: Value, beside: float = 0.0) -> str:
        """What is seen of `value` at `path`, as text: NaN is equal to itself."""
        values: dict[str, Value] = dict.fromkeys(self._beside(path), beside) if beside else {}
        values[path] = value
        self._now += _PACE
        pieces = self._guard.apply(serialize(self._layout, values), self._now)
        if pieces is None:
            raise MessageRefused("no message passes")
        return _key(read_back(self._layout, b"".join(pieces))[path])

    def _beside(self, path: str) -> list[str]:
        """The other numbers of the same message within the message: y and z beside x."""
        parent, _, _ = path.rpartition(".")
        return [
            other
            for other, kind in self._leaves.items()
            if other != path and other.rpartition(".")[0] == parent
            and isinstance(kind, Primitive) and kind.code in "fd"
        ]  # fmt: skip


def _stateless(rule: FilterRule) -> FilterRule:
    """Without hysteresis, which only makes cells overlap: what was sent before counts for it."""
    return replace(rule, parameters=tuple(x for x in rule.parameters if x[0] != "hysteresis"))


def _range(kind: Primitive) -> tuple[float, float]:
    if kind.code in "fd":
        return -math.inf, math.inf
    if len(kind.code) == 2:
        return (0.0 if kind.name == "time" else -(2.0**31)), 2.0**31 - 1
    bits = _BOUNDS[kind.code]
    return (-(2.0**bits) if kind.code.islower() else 0.0), 2.0**bits - 1


def _key(value: Value | None) -> str:
    return repr(float(value)) if isinstance(value, int | float) else repr(value)
