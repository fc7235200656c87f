"""Messages of any type as bytes, by a seeded generator: two that differ only in chosen fields."""

import random  # noqa: TID251 - seeded, for reproducible failures
import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from grants.decision import Decision
from grants.filters.hashing import FILTER_KEY_SIZE
from grants.filters.layout import Array, Layout, Primitive, Struct, Text, Type
from grants.guard import Guard
from grants.model import Restriction, Right
from grants.vocabulary.contents import describe
from grants.vocabulary.levels import PSEUDONYM_KEY, Levels, Resolved, resolve

Chosen = Callable[[str], bool]
_Drawn = TypeVar("_Drawn")
NOW = 1_795_000_000


@dataclass
class Maker:
    """Makes messages: the same ones for the same seed, but for the chosen fields.

    Args:
        seed: of all that is not chosen.
        other: seed of the chosen fields, and of the lengths of chosen arrays.
        chosen: by path.
        cells: by path, the size of cells: these numbers stay in theirs whatever `other` is.
    """

    seed: int
    other: int
    chosen: Chosen = lambda _: False
    cells: Callable[[str], float] = lambda _: 0.0

    def __call__(self, layout: Layout) -> bytes:
        self._same, self._varied = random.Random(self.seed), random.Random(self.other)
        return self._value(layout.root, "", "")

    def _value(self, kind: Type, path: str, above: str) -> bytes:
        match kind:
            case Struct("sensor_msgs/Image"):
                return self._image(kind, path)
            case Struct(_, fields):
                within = f"{path}." if path else ""
                return b"".join(self._value(k, within + name, kind.name) for name, k in fields)
            case Array(element, length):
                return self._array(element, length, path, above)
            case Text():
                return self._text(path)
            case Primitive():
                return self._number(kind, path)
        raise AssertionError(kind)

    def _array(self, element: Type, length: int | None, path: str, above: str) -> bytes:
        count = self._drawn(path, lambda rng: rng.randrange(4)) if length is None else length
        step = f"{path}[*]" if isinstance(element, Struct) else path
        # Each element has its own seeds: another count does not shift what follows.
        inner = Maker(self._same.getrandbits(32), self._varied.getrandbits(32), self.chosen)
        inner._same, inner._varied = random.Random(inner.seed), random.Random(inner.other)
        items = b"".join(inner._value(element, step, above) for _ in range(count))
        return (b"" if length is not None else struct.pack("<I", count)) + items

    def _drawn(self, path: str, draw: Callable[[random.Random], _Drawn]) -> _Drawn:
        drawn = draw(self._same), draw(self._varied)
        return drawn[self.chosen(path)]

    def _text(self, path: str) -> bytes:
        data = self._drawn(path, lambda rng: bytes(rng.choices(b"abcdef", k=5)))
        return struct.pack("<I", len(data)) + data

    def _number(self, kind: Primitive, path: str) -> bytes:
        if kind.code in ("f", "d"):
            return struct.pack(f"<{kind.code}", self._float(path))
        data = self._drawn(path, lambda rng: rng.randbytes(kind.size))
        return bytes(b & 1 for b in data) if kind.name == "bool" else data

    def _float(self, path: str) -> float:
        size = self.cells(path)
        if size == 0:
            return self._drawn(path, lambda rng: rng.randrange(-64_000, 64_000) / 64)
        cell, within = self._same.randrange(-40, 40), self._varied.uniform(-0.49, 0.49)
        return (cell + within) * size

    def _image(self, kind: Struct, path: str) -> bytes:
        """A picture that is one: its data has the size that it says."""
        within = f"{path}." if path else ""
        fields = dict(kind.fields)
        head = self._value(fields["header"], f"{within}header", kind.name)
        data = self._drawn(f"{within}data", lambda rng: rng.randbytes(40 * 40))
        sizes = struct.pack("<II", 40, 40) + struct.pack("<I", 5) + b"mono8"
        return head + sizes + struct.pack("<BII", 0, 40, len(data)) + data


def guard(layout: Layout, levels: Levels) -> Guard:
    """The guard of a receiver that sees messages at these levels."""
    return guard_of(layout, resolve(layout, describe(layout), levels))


def guard_of(layout: Layout, found: Resolved) -> Guard:
    """The guard of these filters, without their limits."""
    restrictions = (Restriction(layout.type_name, (), found.rules),) if found.rules else ()
    decision = Decision(Right.SUBSCRIBE, "/topic", (), NOW + 10**9, restrictions)
    return Guard(layout, decision, {PSEUDONYM_KEY: bytes(FILTER_KEY_SIZE)})


def through(layout: Layout, levels: Levels, message: bytes) -> bytes:
    """What the receiver gets of a first message."""
    pieces = guard(layout, levels)(message, NOW)
    assert pieces is not None
    return b"".join(pieces)
