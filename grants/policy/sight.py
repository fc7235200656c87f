"""How precisely a receiver sees a field, by the algebra of the filters of a verdict. Pure.

What each operator lets through is a table (`grants.filters.passing`), which holds for every value
of the field's type. Numbers pass functions that never decrease, so one is hidden if the ends of its
range, both zeros and NaN become the same: that is tried, on the filters the publisher would run.
A field that a condition reads is not hidden, and finer than any step: that a message comes tells.
"""

import math
from collections.abc import Collection
from dataclasses import replace
from typing import Final

from grants.conditions.fields import reads
from grants.decision import Decision
from grants.errors import MessageRefused
from grants.filters.hashing import FILTER_KEY_SIZE
from grants.filters.layout import Layout, Primitive, Text
from grants.filters.passing import Passing, Through, passing, size_of
from grants.guard import Guard, needed_keys
from grants.model import FilterRule
from grants.policy.decision import Verdict
from grants.policy.privacy import filters_of
from grants.policy.sample_messages import Value, leaves, read_back, serialize

_FOREVER: Final = 1 << 53
_NOW: Final = 1_000_000
_TOLERANCE: Final = 1e-6


class Sight:
    """What the receiver of a verdict sees of messages of one layout.

    `frames`: the leaves that name frames, which conditions may read: as in `vocabulary.assess` a
    frame is a setting of the robot, which the condition names, and no value that changes.

    Raises:
        GrantError: the filters do not fit the layout; its methods: they depend on other fields, so
            nothing is known.
    """

    def __init__(
        self, layout: Layout, verdict: Verdict, frames: Collection[str] = frozenset()
    ) -> None:
        self._frames = frames
        self._layout = layout
        self._leaves = leaves(layout)
        self._conditions = [text for each in verdict.restrictions for text in each.conditions]
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

    def is_hidden(self, path: str) -> bool:
        """Whether the leaf at `path` is the same whatever is sent, and whether or not it is."""
        return not self._is_read(path) and self._is_constant(path)

    def is_exact(self, path: str) -> bool:
        """Whether the leaf at `path` is seen as it is sent."""
        return all(each.through is Through.ALL for each in self._passing(path))

    def is_no_finer_than(self, path: str, step: float) -> bool:
        """Whether every number seen at `path` stands for an interval of at least `step`.

        Not NaN and the infinities, which pass `round` and are no interval.
        """
        if self._is_read(path):
            return False
        size = size_of(self._passing(path))
        return self._is_constant(path) or size >= step * (1 - _TOLERANCE)

    def _is_read(self, path: str) -> bool:
        return path not in self._frames and any(reads(text, path) for text in self._conditions)

    def _passing(self, path: str) -> list[Passing]:
        kind = self._leaves[path]
        return [passing(rule, kind, path) for rule in filters_of(self._rules, path)]

    def _is_constant(self, path: str) -> bool:
        passed = self._passing(path)
        if any(each.through is Through.NOTHING for each in passed):
            return True
        kind = self._leaves[path]
        if not any(each.through is Through.RANGE for each in passed) or isinstance(kind, Text):
            return False
        return len({self._seen(path, value) for value in _ends(kind)}) == 1

    def _seen(self, path: str, value: Value) -> str:
        """What is seen of `value` at `path`, as text: NaN is equal to itself, zeros differ."""
        pieces = self._guard.apply(serialize(self._layout, {path: value}), _NOW)
        if pieces is None:
            raise MessageRefused("no message passes")
        return repr(read_back(self._layout, b"".join(pieces))[path])


def _stateless(rule: FilterRule) -> FilterRule:
    """Without hysteresis, which only makes cells overlap: what was sent before counts for it."""
    return replace(rule, parameters=tuple(x for x in rule.parameters if x[0] != "hysteresis"))


def _ends(kind: Primitive) -> tuple[Value, ...]:
    """Between these are all values of the type, and NaN beside them."""
    if kind.code in "fd":
        return (-math.inf, -0.0, 0.0, math.inf, math.nan)
    bits = 8 * kind.size
    return (-(1 << bits - 1), (1 << bits - 1) - 1) if kind.code.islower() else (0, (1 << bits) - 1)
