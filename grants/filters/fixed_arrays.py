"""Arrays of fixed-size elements, treated column by column with numpy.

One copy of the elements is made, read as a table with the treated values as its columns; adjacent
values under one treatment are one column, so a thousand points cost three calls.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from grants.filters.codegen import Buffer
from grants.filters.layout import Primitive
from grants.filters.lazy_numpy import Vector, np
from grants.filters.treatments import (
    ArrayTreatment,
    Constant,
    FieldTreatment,
    Node,
    Numbers,
    StructTreatment,
)


@dataclass(frozen=True)
class Column:
    """`count` values of one format, side by side in every element of an array."""

    offset: int
    code: str
    count: int
    vector: Callable[[Vector], Vector]

    def is_continued_by(self, other: "Column") -> bool:
        """Whether `other` follows this column with the same treatment."""
        end = self.offset + self.count * np.dtype(self.code).itemsize
        return (end, self.code, self.vector) == (other.offset, other.code, other.vector)


def columns(node: Node, offset: int) -> list[Column]:
    """The treated values of one fixed-size element that begins at `offset`."""
    match node:
        case StructTreatment(kind, parts):
            found = []
            for (_, member), part in zip(kind.fields, parts, strict=True):
                found += columns(part, offset)
                offset += member.size or 0
            return found
        case ArrayTreatment(kind, element):
            size = kind.element.size or 0
            return [
                column
                for n in range(kind.length or 0)
                for column in columns(element, offset + n * size)
            ]
        case FieldTreatment(_, Constant(data)):
            fill = np.frombuffer(data, np.uint8)
            return [Column(offset, "<u1", len(data), lambda _: fill)]
        case FieldTreatment(Primitive(code=code), Numbers(vector=vector)):
            return [Column(offset, f"<{code[0]}", len(code), vector)]
        case _:
            return []


def _merged(found: list[Column]) -> list[Column]:
    merged: list[Column] = []
    for column in found:
        if merged and merged[-1].is_continued_by(column):
            last = merged.pop()
            column = Column(last.offset, last.code, last.count + column.count, last.vector)  # noqa: PLW2901 - merged
        merged.append(column)
    return merged


@dataclass(frozen=True)
class Table:
    """The treated values of many elements of `size` bytes each, as columns."""

    dtype: "np.dtype[Any]"
    treatments: tuple[tuple[str, Callable[[Vector], Vector]], ...]

    def apply(self, elements: Vector) -> None:
        """TreatmentForType `elements` (of `dtype`) in place."""
        for name, vector in self.treatments:
            elements[name] = vector(elements[name])


def table(node: Node, size: int) -> Table:
    """The table for elements of `size` bytes with the treatments in `node`."""
    return table_from_columns(columns(node, 0), size)


def table_from_columns(found: list[Column], size: int) -> Table:
    """The table with these columns."""
    merged = _merged(found)
    names = [f"f{n}" for n in range(len(merged))]
    dtype: np.dtype[Any] = np.dtype(
        {
            "names": names,
            "formats": [(column.code, (column.count,)) for column in merged],
            "offsets": [column.offset for column in merged],
            "itemsize": size,
        }
    )
    return Table(dtype, tuple((n, column.vector) for n, column in zip(names, merged, strict=True)))


def table_rewriter(element: Node, size: int) -> Callable[[Buffer, int, int], Buffer]:
    """Return a function of message, start and count of the elements, to the elements' new bytes.

    It raises ValueError if the message is too short.
    """
    match element:
        case FieldTreatment(Primitive(code=code), Numbers(vector=vector)):
            return _numbers_rewriter(f"<{code[0]}", len(code), vector)
        case _:
            return _elements_rewriter(table(element, size))


def _numbers_rewriter(
    code: str, values: int, vector: Callable[[Vector], Vector]
) -> Callable[[Buffer, int, int], Buffer]:
    """For arrays of numbers: without a table, and without a copy to change."""

    def rewrite(message: Buffer, start: int, count: int) -> Buffer:
        if count == 0:
            return b""
        numbers = np.frombuffer(message, code, count * values, start)
        return vector(numbers).astype(code, copy=False).tobytes()

    return rewrite


def _elements_rewriter(table: Table) -> Callable[[Buffer, int, int], Buffer]:
    size = table.dtype.itemsize

    def rewrite(message: Buffer, start: int, count: int) -> Buffer:
        end = start + count * size
        if end > len(message):
            raise ValueError
        if count == 0:
            return b""
        copy = bytearray(message[start:end])
        table.apply(np.frombuffer(copy, table.dtype))
        return copy

    return rewrite
