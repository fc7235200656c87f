"""Arrays whose elements all have one size, treated column by column with numpy.

One copy of the elements is made, read as a table with the treated values as its columns;
neighbouring values under one treatment are one column, so a thousand points cost three calls.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from grants.codegen import Buffer
from grants.layout import Primitive
from grants.treatments import Constant, Each, Node, Numbers, Parts, Treated, Vector


@dataclass(frozen=True)
class _Column:
    """`count` values of one format, side by side in every element of an array."""

    offset: int
    code: str
    count: int
    vector: Callable[[Vector], Vector]

    def joins(self, other: "_Column") -> bool:
        end = self.offset + self.count * np.dtype(self.code).itemsize
        return (end, self.code, self.vector) == (other.offset, other.code, other.vector)


def _columns(node: Node, offset: int) -> list[_Column]:
    """What is treated inside one fixed-size element."""
    match node:
        case Parts(kind, parts):
            found = []
            for (_, member), part in zip(kind.fields, parts, strict=True):
                found += _columns(part, offset)
                offset += member.size or 0
            return found
        case Each(kind, element):
            size = kind.element.size or 0
            return [
                column
                for n in range(kind.length or 0)
                for column in _columns(element, offset + n * size)
            ]
        case Treated(_, Constant(data)):
            fill = np.frombuffer(data, np.uint8)
            return [_Column(offset, "<u1", len(data), lambda _: fill)]
        case Treated(Primitive(code=code), Numbers(vector=vector)):
            return [_Column(offset, f"<{code[0]}", len(code), vector)]
        case _:
            return []


def _merged(columns: list[_Column]) -> list[_Column]:
    merged: list[_Column] = []
    for column in columns:
        if merged and merged[-1].joins(column):
            last = merged.pop()
            column = _Column(last.offset, last.code, last.count + column.count, last.vector)  # noqa: PLW2901
        merged.append(column)
    return merged


def table_rewriter(element: Node, size: int) -> Callable[[Buffer, int, int], Buffer]:
    """Return a function of message, start and count of the elements, to the elements' new bytes.

    It raises ValueError when the message is shorter than that.
    """
    columns = _merged(_columns(element, 0))
    names = [f"f{n}" for n in range(len(columns))]
    dtype: np.dtype[Any] = np.dtype(
        {
            "names": names,
            "formats": [(column.code, (column.count,)) for column in columns],
            "offsets": [column.offset for column in columns],
            "itemsize": size,
        }
    )
    treatments = [(name, column.vector) for name, column in zip(names, columns, strict=True)]

    def rewrite(message: Buffer, start: int, count: int) -> Buffer:
        end = start + count * size
        if end > len(message):
            raise ValueError
        if count == 0:
            return b""
        copy = bytearray(message[start:end])
        table = np.frombuffer(copy, dtype)
        for name, vector in treatments:
            table[name] = vector(table[name])
        return copy

    return rewrite
