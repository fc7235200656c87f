"""Arrays of elements of different sizes, whose treated values keep their position.

Treating such an array value by value costs more than everything else a filter does. Here the
generated loop only records where the treated values are; they are then taken out of one copy of the
array, treated column by column with numpy, and put back. This requires treatments that preserve
every size: numbers, and constants of a fixed size.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from grants.filters.codegen import Buffer, Cursor, Position, SourceWriter
from grants.filters.fixed_arrays import Column, Table, columns, table_from_columns
from grants.filters.lazy_numpy import Vector, np
from grants.filters.treatments import ArrayTreatment, Keep, Node, StructTreatment


def preserves_sizes(node: Node) -> bool:
    """Whether all treatments in `node` preserve every size."""
    if isinstance(node, Keep) or node.kind.size is not None:
        return True
    if isinstance(node, StructTreatment):
        return all(map(preserves_sizes, node.parts))
    if isinstance(node, ArrayTreatment):
        return node.kind.element.size is None and preserves_sizes(node.element)
    return False


@dataclass
class _Region:
    """Adjacent treated values in an element; the list `name` has their positions."""

    name: str
    end: Position
    size: int
    columns: list[Column]


class ArrayCollector(Cursor):
    """A cursor that records where the treated values of elements begin."""

    def __init__(self, source: SourceWriter) -> None:
        super().__init__(source)
        self._declared = source.line("")
        self._regions: list[_Region] = []

    def collect(self, node: Node) -> None:
        """Move over `node`, writing code that records positions. Requires `preserves_sizes`."""
        size = node.kind.size
        match node:
            case StructTreatment(_, parts) if size is None:
                for part in parts:
                    self.collect(part)
            case ArrayTreatment(kind, element) if size is None:
                with self.each(kind):
                    self.collect(element)
            case _ if isinstance(node, Keep) or not size:
                self.skip(node.kind)
            case _:
                self._note(node, size)

    def _note(self, node: Node, size: int) -> None:
        if not self._regions or self._regions[-1].end != self.position:
            name = self.source.new("g")
            self.source.line(f"{name}.append({self.at()})")
            self._regions.append(_Region(name, self.position, 0, []))
        region = self._regions[-1]
        region.columns += columns(node, region.size)
        region.size += size
        self.skip(node.kind)
        region.end = self.position

    def finish(self) -> str:
        """Declare the lists; return an expression for a function of message, start and end."""
        names = [region.name for region in self._regions]
        self.source.replace(self._declared, ";".join(f"{name}=[]" for name in names))
        tables = [table_from_columns(region.columns, region.size) for region in self._regions]
        return f"{self.source.bind(_patcher(tables))}(({''.join(f'{name},' for name in names)}))"


def _patcher(
    tables: list[Table],
) -> Callable[[tuple[list[int], ...]], Callable[[Buffer, int, int], Buffer]]:
    return lambda positions: partial(_patch, tables, positions)


def _patch(
    tables: list[Table], positions: tuple[list[int], ...], message: Buffer, start: int, end: int
) -> Buffer:
    """A copy of `message[start:end]` with the values at `positions` treated.

    Raises:
        ValueError: the message is too short.
    """
    if end > len(message):
        raise ValueError
    copy = bytearray(message[start:end])
    for table, offsets in zip(tables, positions, strict=True):
        if offsets:
            size = table.dtype.itemsize
            at = np.array(offsets, np.intp) - start
            # One window at every position where `size` bytes fit; indexing copies the windows.
            windows: Vector = np.ndarray((len(copy) - size + 1,), f"V{size}", copy, 0, (1,))
            elements = windows[at]
            table.apply(elements.view(table.dtype))
            windows[at] = elements
    return copy
