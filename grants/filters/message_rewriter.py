"""From a treated layout to a function on bytes: kept parts are sliced, treated parts are computed.

The generated function returns the pieces of the new message in order, for scatter-gather sending: kept parts
are slices of the message (an image is never copied), adjacent treated numbers go through one `struct` call,
arrays of numbers and arrays of fixed-size messages through numpy, column by column in one copy.
"""

import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final

from grants.filters.coarsening import Vector, np
from grants.filters.layout import (
    LAYOUT_ERRORS,
    Array,
    Buffer,
    Cursor,
    Position,
    Primitive,
    SourceWriter,
    Struct,
    Type,
    expression,
    layout_mismatch,
)
from grants.filters.operators import (
    ArrayTreatment,
    Constant,
    ContentTreatment,
    FieldTreatment,
    Keep,
    Node,
    Numbers,
    SiblingTreatment,
    StructTreatment,
)


@dataclass(frozen=True)
class Column:
    offset: int
    code: str
    count: int
    vector: Callable[[Vector], Vector]

    def is_continued_by(self, other: "Column") -> bool:
        end = self.offset + self.count * np.dtype(self.code).itemsize
        return (end, self.code, self.vector) == (other.offset, other.code, other.vector)


def columns(node: Node, offset: int) -> list[Column]:
    match node:
        case StructTreatment(kind, parts):
            found = []
            for (_, member), part in zip(kind.fields, parts, strict=True):
                found += columns(part, offset)
                offset += member.size or 0
            return found
        case ArrayTreatment(kind, element):
            size = kind.element.size or 0
            return [column for n in range(kind.length or 0) for column in columns(element, offset + n * size)]
        case FieldTreatment(_, Constant(data)):
            fill = np.frombuffer(data, np.uint8)
            return [Column(offset, "<u1", len(data), lambda _: fill)]
        case FieldTreatment(Primitive(code=code), Numbers(vector=vector)):
            return [Column(offset, f"<{code[0]}", len(code), vector)]
        case _:
            return []


@dataclass(frozen=True)
class Table:
    """The treated values of many elements, as columns; adjacent ones under one treatment are one column."""

    dtype: "np.dtype[Any]"
    treatments: tuple[tuple[str, Callable[[Vector], Vector]], ...]

    def apply(self, elements: Vector) -> None:
        for name, vector in self.treatments:
            elements[name] = vector(elements[name])


def table(found: list[Column], size: int) -> Table:
    merged: list[Column] = []
    for column in found:
        if merged and merged[-1].is_continued_by(column):
            last = merged.pop()
            count = last.count + column.count
            merged.append(Column(last.offset, last.code, count, last.vector))
        else:
            merged.append(column)
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
    # A function of message, start and count of the elements, to their new bytes. ValueError: the message is
    # too short.
    match element:
        case FieldTreatment(Primitive(code=code), Numbers(vector=vector)):
            dtype, values = f"<{code[0]}", len(code)
        case _:
            return _elements_rewriter(table(columns(element, 0), size))

    def rewrite(message: Buffer, start: int, count: int) -> Buffer:
        if count == 0:
            return b""
        numbers = np.frombuffer(message, dtype, count * values, start)
        return vector(numbers).astype(dtype, copy=False).tobytes()

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


def preserves_sizes(node: Node) -> bool:
    if isinstance(node, Keep) or node.kind.size is not None:
        return True
    if isinstance(node, StructTreatment):
        return all(map(preserves_sizes, node.parts))
    if isinstance(node, ArrayTreatment):
        return node.kind.element.size is None and preserves_sizes(node.element)
    return False


@dataclass
class _Region:
    name: str
    end: Position
    size: int
    columns: list[Column]


# Treating an array of elements of different sizes value by value costs more than everything else a filter
# does. Here the generated loop only records where the treated values are; they are then taken out of one
# copy of the array, treated column by column with numpy, and put back. This requires treatments that
# preserve every size: numbers, and constants of a fixed size.
class ArrayCollector(Cursor):
    def __init__(self, source: SourceWriter) -> None:
        super().__init__(source)
        self._declared = source.line("")
        self._regions: list[_Region] = []

    def collect(self, node: Node) -> None:
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
        names = [region.name for region in self._regions]
        self.source.replace(self._declared, ";".join(f"{name}=[]" for name in names))
        tables = [table(region.columns, region.size) for region in self._regions]
        patcher = self.source.bind(lambda positions: partial(_patch, tables, positions))
        return f"{patcher}(({''.join(f'{name},' for name in names)}))"


def _patch(
    tables: list[Table], positions: tuple[list[int], ...], message: Buffer, start: int, end: int
) -> Buffer:
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


MAX_PIECES: Final = 64  # far below IOV_MAX (1024); more of them cost more than they save
_UNROLL: Final = range(1, 9)  # fixed arrays of these lengths are cheaper without numpy
MIN_COLLECTED: Final = 24  # elements from which numpy is faster


SMALL: Final = 2048  # bytes; below it a copy is cheaper than a view


def generate(node: Node, type_name: str) -> Callable[[Buffer], list[Buffer]]:
    """The function; a message that is not a `type_name` is refused (`MessageRefused`)."""
    source = SourceWriter("b")
    source.line(f"if len(b)>={SMALL}: b={source.bind(memoryview)}(b)")
    writer = _Writer(source)
    writer.write(node)
    pieces = writer.finish()
    # Only a loop can make many pieces; a copy is then cheaper than a long list.
    many = len(pieces) > MAX_PIECES or any(piece.startswith("*") for piece in pieces)
    result = f"[{','.join(pieces)}]"
    source.line(f"if len(b)!={writer.at()}: raise ValueError")
    if many:
        limit = source.bind(lambda made: made if len(made) <= MAX_PIECES else [b"".join(made)])
        result = f"{limit}({result})"
    source.line(f"return {result}")
    return source.compile(
        LAYOUT_ERRORS, f"raise {source.bind(partial(layout_mismatch, type_name))}() from None"
    )


@dataclass
class _Run:
    start: Position
    end: Position
    items: list[tuple[Primitive, Numbers] | bytes] = field(default_factory=list)


class _Writer(Cursor):
    def __init__(self, source: SourceWriter) -> None:
        super().__init__(source)
        self._copied: Position = ("", 0)
        self._run: _Run | None = None
        self._pieces: list[str] = []

    def write(self, node: Node) -> None:
        match node:
            case Keep(kind):
                self.skip(kind)
            case StructTreatment(kind, parts):
                self._parts(kind, parts)
            case ArrayTreatment(kind, element):
                self._array(kind, element)
            case _:
                self._treated(node.kind, node.treatment)

    def _parts(self, kind: Struct, parts: tuple[Node, ...]) -> None:
        needed = {name for part in parts for name in _siblings(part)}
        values: dict[str, str] = {}
        for (name, member), part in zip(kind.fields, parts, strict=True):
            start = self.position
            match part:
                case FieldTreatment(_, SiblingTreatment(siblings=siblings, rewrite=rewrite)):
                    self._content(member, rewrite, [values[other] for other, _ in siblings])
                case _:
                    self.write(part)
            if name in needed:
                values[name] = self._value(member, start)

    def _value(self, kind: Type, start: Position) -> str:
        name = self.source.new("v")
        if isinstance(kind, Primitive):
            read = self.source.bind(struct.Struct(f"<{kind.code}").unpack_from)
            self.source.line(f"{name},={read}(b,{expression(start)})")
        else:
            self.source.line(f"{name}=str(b[{expression(start, 4)}:{self.at()}],'utf-8')")
        return name

    def finish(self) -> list[str]:
        self._flush()
        pieces, self._pieces = self._pieces, []
        if self._copied != self.position or not pieces:
            pieces.append(f"b[{expression(self._copied)}:]")
        return pieces

    def _treated(
        self, kind: Type, treatment: Constant | Numbers | ContentTreatment | SiblingTreatment
    ) -> None:
        match treatment:
            case Constant(data):
                if kind.size is None:
                    self._replace(kind, self.source.bind(data))
                else:
                    self._extend(kind, data)
            case Numbers():
                assert isinstance(kind, Primitive)  # noqa: S101 - for the type checker
                self._extend(kind, (kind, treatment))
            case _:  # `SiblingTreatment` is handled in `_parts`
                self._content(kind, treatment.rewrite, [])

    def _replace(self, kind: Type, *pieces: str) -> None:
        self._flush()
        self.skip(kind)
        self._pieces.extend(pieces)
        self._copied = self.position

    def _content(self, kind: Type, rewrite: Callable[..., tuple[Buffer, int]], siblings: list[str]) -> None:
        start = self.position
        self._flush()
        self.skip(kind)
        head, body = self.source.new("h"), self.source.new("c")
        content = ",".join([f"b[{expression(start, 4)}:{self.at()}]", *siblings])
        self.source.line(f"{head},{body}={self.source.bind(_prefixed(rewrite))}({content})")
        self._pieces += [head, body]
        self._copied = self.position

    def _extend(self, kind: Type, item: tuple[Primitive, Numbers] | bytes) -> None:
        if self._run is None or self._run.end != self.position:
            self._close()
            self._run = _Run(self.position, self.position)
        self._run.items.append(item)
        self.skip(kind)
        self._run.end = self.position

    def _flush(self) -> None:
        self._close()
        self._keep_until(self.position)

    def _keep_until(self, end: Position) -> None:
        if self._copied != end:
            self._pieces.append(f"b[{expression(self._copied)}:{expression(end)}]")
            self._copied = end

    def _close(self) -> None:
        if self._run is None:
            return
        run, self._run = self._run, None
        self._keep_until(run.start)
        self._pieces.append(self._packed(run))
        self._copied = run.end

    def _packed(self, run: _Run) -> str:
        unpack, pack, values, results = "<", "<", [], []
        for item in run.items:
            if isinstance(item, bytes):
                unpack, pack = f"{unpack}{len(item)}x", f"{pack}{len(item)}s"
                results.append(self.source.bind(item))
                continue
            kind, numbers = item
            unpack, pack = unpack + kind.code, pack + kind.code
            names = [self.source.new("x") for _ in kind.code]
            values += names
            star = "*" if len(names) > 1 else ""
            results.append(f"{star}{self.source.bind(numbers.scalar)}({','.join(names)})")
        if not values:
            return self.source.bind(b"".join(item for item in run.items if isinstance(item, bytes)))
        read = self.source.bind(struct.Struct(unpack).unpack_from)
        self.source.line(f"{','.join(values)},={read}(b,{expression(run.start)})")
        return f"{self.source.bind(struct.Struct(pack).pack)}({','.join(results)})"

    def _array(self, kind: Array, element: Node) -> None:
        size = kind.element.size
        if size is None:
            self._loop(kind, element)
        elif isinstance(kind.element, Primitive) and kind.length in _UNROLL:
            for _ in range(kind.length or 0):
                self.write(element)
        else:
            self._table(kind, size, element)

    def _table(self, kind: Array, size: int, element: Node) -> None:
        count = self.count(kind)
        start = self.position
        self._flush()
        self.jump(f"{self.at()}+{count}*{size}")
        table = self.source.bind(table_rewriter(element, size))
        name = self.source.new("t")
        self.source.line(f"{name}={table}(b,{expression(start)},{count})")
        self._pieces.append(name)
        self._copied = self.position

    def _loop(self, kind: Array, element: Node) -> None:
        self._close()
        pieces, kept = self.source.new("l"), self.source.new("s")
        self.source.line(f"{pieces}=[]")
        self.source.line(f"{kept}={expression(self._copied)}")
        outer, self._pieces = self._pieces, []
        collect = not self.source.nested and preserves_sizes(element)
        count = self.count(kind)
        mark = self.mark()
        if collect:
            with self.source.block(f"if {count}<{MIN_COLLECTED}"):
                self._one_by_one(element, count, mark, pieces, kept)
            with self.source.block("else"):
                self._collected(element, count, mark, pieces, kept)
        else:
            self._one_by_one(element, count, mark, pieces, kept)
        self._pieces, self._copied = [*outer, f"*{pieces}"], (kept, 0)

    def _one_by_one(self, element: Node, count: str, mark: str, pieces: str, kept: str) -> None:
        self._copied = (kept, 0)
        with self.times(count, mark):
            self.write(element)
            self._close()
            self.source.line(f"{pieces}+=[{','.join(self._pieces)}]")
            self.source.line(f"{kept}={expression(self._copied)}")
            self._pieces = []

    def _collected(self, element: Node, count: str, mark: str, pieces: str, kept: str) -> None:
        # Only collect the positions in the loop; numpy then treats all of them in one copy.
        collector = ArrayCollector(self.source)
        collector.position = (mark, 0)
        with collector.times(count, mark):
            collector.collect(element)
        self.source.line(f"{pieces}.append({collector.finish()}(b,{kept},{mark}))")
        self.source.line(f"{kept}={mark}")
        self.position = (mark, 0)


def _siblings(node: Node) -> tuple[str, ...]:
    match node:
        case FieldTreatment(_, SiblingTreatment(siblings=siblings)):
            return tuple(name for name, _ in siblings)
        case _:
            return ()


def _prefixed(rewrite: Callable[..., tuple[Buffer, int]]) -> Callable[..., tuple[bytes, Buffer]]:
    def rewritten(*values: Any) -> tuple[bytes, Buffer]:
        body, length = rewrite(*values)
        return length.to_bytes(4, "little"), body

    return rewritten
