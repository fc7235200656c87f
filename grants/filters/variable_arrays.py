"""Arrays of elements of different sizes, whose treated values keep their place.

Going through such an array value by value costs more than everything else a filter does. Here the
generated loop only notes where the treated values are; they are then taken out of one copy of the
array, treated column by column with numpy, and put back. This needs treatments that leave every
size as it is: numbers, and constants of a fixed size.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from grants.filters.codegen import Buffer, Cursor, Position, SourceWriter
from grants.filters.fixed_arrays import Column, Table, columns, table_of
from grants.filters.lazy_numpy import Vector, np
from grants.filters.treatments import Each, Keep, Node, StructTreatment


def gathers(node: Node) -> bool:
    """Whether all treatments in `node` leave every size as it is."""
    if isinstance(node, Keep) or node.kind.size is not None:
        return True
    if isinstance(node, StructTreatment):
        return all(map(gathers, node.parts))
    if isinstance(node, Each):
        return node.kind.element.size is None and gathers(node.element)
    return False


@dataclass
class _Region:
    """Treated values side by side in an element: they begin at the places in the list `name`."""

    name: str
    end: Position
    size: int
    columns: list[Column]


class ArrayCollector(Cursor):
    """A cursor that notes where the treated values of elements begin."""

    def __init__(self, source: SourceWriter) -> None:
        super().__init__(source)
        self._declared = source.line("")
        self._regions: list[_Region] = []

    def collect(self, node: Node) -> None:
        """Move over `node`, writing what notes its places. Only for what `gathers`."""
        size = node.kind.size
        match node:
            case StructTreatment(_, parts) if size is None:
                for part in parts:
                    self.collect(part)
            case Each(kind, element) if size is None:
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
        tables = [table_of(region.columns, region.size) for region in self._regions]
        return f"{self.source.bind(_patcher(tables))}(({''.join(f'{name},' for name in names)}))"


def _patcher(
    tables: list[Table],
) -> Callable[[tuple[list[int], ...]], Callable[[Buffer, int, int], Buffer]]:
    return lambda places: partial(_patch, tables, places)


def _patch(
    tables: list[Table], places: tuple[list[int], ...], message: Buffer, start: int, end: int
) -> Buffer:
    """A copy of `message[start:end]` with the values at `places` treated.

    Raises:
        ValueError: the message is shorter than that.
    """
    if end > len(message):
        raise ValueError
    copy = bytearray(message[start:end])
    for treated, found in zip(tables, places, strict=True):
        if found:
            size = treated.dtype.itemsize
            at = np.array(found, np.intp) - start
            # Every position at which `size` bytes can begin: indexing takes out what is there.
            windows: Vector = np.ndarray((len(copy) - size + 1,), f"V{size}", copy, 0, (1,))
            elements = windows[at]
            treated.apply(elements.view(treated.dtype))
            windows[at] = elements
    return copy
