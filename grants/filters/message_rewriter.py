"""From a treated layout to a function on bytes: kept parts are sliced, treated parts are computed.

The generated function returns the pieces of the new message in order, for scatter-gather
sending: kept parts are slices of the message (an image is never copied), adjacent treated
numbers go through one `struct` call, arrays of numbers and arrays of fixed-size messages through
numpy. It raises one of `codegen.LAYOUT_ERRORS` if the message does not have the layout.
"""

import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final

from grants.filters.codegen import Buffer, Cursor, Position, SourceWriter, expression
from grants.filters.fixed_arrays import table_rewriter
from grants.filters.layout import Array, Primitive, Struct, Type
from grants.filters.treatments import (
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
from grants.filters.variable_arrays import ArrayCollector, preserves_sizes

MAX_PIECES: Final = 64  # far below IOV_MAX (1024); more of them cost more than they save
_UNROLL: Final = range(1, 9)  # fixed arrays of these lengths are cheaper without numpy
MIN_COLLECTED: Final = 24  # elements from which numpy is faster


def generate(node: Node) -> Callable[[Buffer], list[Buffer]]:
    """The function from a message to the pieces of the treated message."""
    source = SourceWriter("b")
    writer = _Writer(source)
    writer.write(node)
    pieces = writer.finish()
    # Only a loop can make many pieces; a copy is then cheaper than a long list.
    many = len(pieces) > MAX_PIECES or any(piece.startswith("*") for piece in pieces)
    result = f"[{','.join(pieces)}]"
    source.line(f"if len(b)!={writer.at()}: raise ValueError")
    source.line(f"return {source.bind(_limit_pieces)}({result})" if many else f"return {result}")
    return source.compile()


def _limit_pieces(pieces: list[Buffer]) -> list[Buffer]:
    return pieces if len(pieces) <= MAX_PIECES else [b"".join(pieces)]


@dataclass
class _Run:
    """Adjacent treated values: one unpack, one pack."""

    start: Position
    end: Position
    items: list[tuple[Primitive, Numbers] | bytes] = field(default_factory=list)


class _Writer(Cursor):
    """A cursor that collects pieces of the message, which are complete up to `_copied`."""

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
        """A variable with the value that begins at `start`, before the present position."""
        name = self.source.new("v")
        if isinstance(kind, Primitive):
            read = self.source.bind(struct.Struct(f"<{kind.code}").unpack_from)
            self.source.line(f"{name},={read}(b,{expression(start)})")
        else:
            self.source.line(f"{name}=str(b[{expression(start, 4)}:{self.at()}],'utf-8')")
        return name

    def finish(self) -> list[str]:
        """All pieces as expressions, the rest of the message last."""
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
        """Replace one value of `kind` by these pieces."""
        self._flush()
        self.skip(kind)
        self._pieces.extend(pieces)
        self._copied = self.position

    def _content(
        self, kind: Type, rewrite: Callable[..., tuple[Buffer, int]], siblings: list[str]
    ) -> None:
        start = self.position
        self._flush()
        self.skip(kind)
        head, body = self.source.new("h"), self.source.new("c")
        content = ",".join([f"b[{expression(start, 4)}:{self.at()}]", *siblings])
        self.source.line(f"{head},{body}={self.source.bind(_prefixed(rewrite))}({content})")
        self._pieces += [head, body]
        self._copied = self.position

    def _extend(self, kind: Type, item: tuple[Primitive, Numbers] | bytes) -> None:
        """Add a fixed-size value to the run, or begin one."""
        if self._run is None or self._run.end != self.position:
            self._close()
            self._run = _Run(self.position, self.position)
        self._run.items.append(item)
        self.skip(kind)
        self._run.end = self.position

    def _flush(self) -> None:
        """Collect everything up to the current position."""
        self._close()
        self._keep_until(self.position)

    def _keep_until(self, end: Position) -> None:
        if self._copied != end:
            self._pieces.append(f"b[{expression(self._copied)}:{expression(end)}]")
            self._copied = end

    def _close(self) -> None:
        """Write the run as one piece."""
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
        """All elements at once, by numpy."""
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
        """One element after another; a kept part may extend into the next element."""
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
        """Only collect the positions in the loop; numpy then treats all of them in one copy."""
        collector = ArrayCollector(self.source)
        collector.position = (mark, 0)
        with collector.times(count, mark):
            collector.collect(element)
        self.source.line(f"{pieces}.append({collector.finish()}(b,{kept},{mark}))")
        self.source.line(f"{kept}={mark}")
        self.position = (mark, 0)


def _siblings(node: Node) -> tuple[str, ...]:
    """The fields whose values the treatment of `node` needs."""
    match node:
        case FieldTreatment(_, SiblingTreatment(siblings=siblings)):
            return tuple(name for name, _ in siblings)
        case _:
            return ()


def _prefixed(
    rewrite: Callable[..., tuple[Buffer, int]],
) -> Callable[..., tuple[bytes, Buffer]]:
    def rewritten(*values: Any) -> tuple[bytes, Buffer]:
        body, length = rewrite(*values)
        return length.to_bytes(4, "little"), body

    return rewritten
