"""From a treated layout to a function on bytes: what is kept is sliced, what is treated is made.

The generated function returns the pieces of the new message in order, for scatter-gather
sending: kept parts are slices of the message (an image is never copied), neighbouring treated
numbers go through one `struct` call, arrays of numbers and arrays of fixed-size messages through
numpy. It raises one of `codegen.MISFIT` when the message does not have the layout.
"""

import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final

from grants.filters.codegen import Buffer, Cursor, Position, SourceWriter, expression
from grants.filters.fixed_arrays import table_rewriter
from grants.filters.layout import Array, Primitive, Struct, Type
from grants.filters.treatments import (
    Constant,
    ContentTreatment,
    Each,
    Inside,
    Keep,
    Node,
    Numbers,
    StructTreatment,
    Treated,
)
from grants.filters.variable_arrays import ArrayCollector, gathers

MAX_PIECES: Final = 64  # far below IOV_MAX (1024); more of them cost more than they save
_UNROLL: Final = range(1, 9)  # fixed arrays of these lengths are cheaper without numpy
_GATHER: Final = 24  # from so many elements on, numpy's fixed costs pay


def generate(node: Node) -> Callable[[Buffer], list[Buffer]]:
    """The function from a message to the pieces of the treated message."""
    source = SourceWriter("b")
    writer = _Writer(source)
    writer.write(node)
    pieces = writer.finish()
    # Only a loop can make many pieces; beyond some of them a copy is cheaper than a long list.
    many = len(pieces) > MAX_PIECES or any(piece.startswith("*") for piece in pieces)
    made = f"[{','.join(pieces)}]"
    source.line(f"if len(b)!={writer.at()}: raise ValueError")
    source.line(f"return {source.bind(_few)}({made})" if many else f"return {made}")
    return source.compile()


def _few(pieces: list[Buffer]) -> list[Buffer]:
    return pieces if len(pieces) <= MAX_PIECES else [b"".join(pieces)]


@dataclass
class _Run:
    """Treated values side by side: one unpack, one pack."""

    start: Position
    end: Position
    items: list[tuple[Primitive, Numbers] | bytes] = field(default_factory=list)


class _Writer(Cursor):
    """A cursor that collects pieces; `_kept` is where the part not yet collected begins."""

    def __init__(self, source: SourceWriter) -> None:
        super().__init__(source)
        self._kept: Position = ("", 0)
        self._run: _Run | None = None
        self._pieces: list[str] = []

    def write(self, node: Node) -> None:
        match node:
            case Keep(kind):
                self.skip(kind)
            case StructTreatment(kind, parts):
                self._parts(kind, parts)
            case Each(kind, element):
                self._array(kind, element)
            case _:
                self._treated(node.kind, node.treatment)

    def _parts(self, kind: Struct, parts: tuple[Node, ...]) -> None:
        needed = {name for part in parts for name in _beside(part)}
        values: dict[str, str] = {}
        for (name, member), part in zip(kind.fields, parts, strict=True):
            start = self.position
            match part:
                case Treated(_, Inside(beside=beside, rewrite=rewrite)):
                    self._body(member, rewrite, [values[other] for other, _ in beside])
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
        if self._kept != self.position or not pieces:
            pieces.append(f"b[{expression(self._kept)}:]")
        return pieces

    def _treated(
        self, kind: Type, treatment: Constant | Numbers | ContentTreatment | Inside
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
            case _:  # `Inside` is never met outside of its message
                self._body(kind, treatment.rewrite, [])

    def _replace(self, kind: Type, *pieces: str) -> None:
        """Other pieces in place of one value of `kind`."""
        self._flush()
        self.skip(kind)
        self._pieces.extend(pieces)
        self._kept = self.position

    def _body(
        self, kind: Type, rewrite: Callable[..., tuple[Buffer, int]], beside: list[str]
    ) -> None:
        start = self.position
        self._flush()
        self.skip(kind)
        head, body = self.source.new("h"), self.source.new("c")
        content = ",".join([f"b[{expression(start, 4)}:{self.at()}]", *beside])
        self.source.line(f"{head},{body}={self.source.bind(_prefixed(rewrite))}({content})")
        self._pieces += [head, body]
        self._kept = self.position

    def _extend(self, kind: Type, item: tuple[Primitive, Numbers] | bytes) -> None:
        """Add a fixed-size value to the run, or begin one."""
        if self._run is None or self._run.end != self.position:
            self._close()
            self._run = _Run(self.position, self.position)
        self._run.items.append(item)
        self.skip(kind)
        self._run.end = self.position

    def _flush(self) -> None:
        """Collect everything before the current position."""
        self._close()
        self._keep_until(self.position)

    def _keep_until(self, end: Position) -> None:
        if self._kept != end:
            self._pieces.append(f"b[{expression(self._kept)}:{expression(end)}]")
            self._kept = end

    def _close(self) -> None:
        """Write the run as one piece."""
        if self._run is None:
            return
        run, self._run = self._run, None
        self._keep_until(run.start)
        self._pieces.append(self._packed(run))
        self._kept = run.end

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
        self._kept = self.position

    def _loop(self, kind: Array, element: Node) -> None:
        """One element after another; what is kept may reach from one into the next."""
        self._close()
        pieces, kept = self.source.new("l"), self.source.new("s")
        self.source.line(f"{pieces}=[]")
        self.source.line(f"{kept}={expression(self._kept)}")
        outer, self._pieces = self._pieces, []
        gather = not self.source.nested and gathers(element)
        count = self.count(kind)
        mark = self.mark()
        if gather:
            with self.source.block(f"if {count}<{_GATHER}"):
                self._one_by_one(element, count, mark, pieces, kept)
            with self.source.block("else"):
                self._gathered(element, count, mark, pieces, kept)
        else:
            self._one_by_one(element, count, mark, pieces, kept)
        self._pieces, self._kept = [*outer, f"*{pieces}"], (kept, 0)

    def _one_by_one(self, element: Node, count: str, mark: str, pieces: str, kept: str) -> None:
        self._kept = (kept, 0)
        with self.times(count, mark):
            self.write(element)
            self._close()
            self.source.line(f"{pieces}+=[{','.join(self._pieces)}]")
            self.source.line(f"{kept}={expression(self._kept)}")
            self._pieces = []

    def _gathered(self, element: Node, count: str, mark: str, pieces: str, kept: str) -> None:
        """Only find the places in the loop; numpy treats all of them in one copy after it."""
        collector = ArrayCollector(self.source)
        collector.position = (mark, 0)
        with collector.times(count, mark):
            collector.collect(element)
        self.source.line(f"{pieces}.append({collector.finish()}(b,{kept},{mark}))")
        self.source.line(f"{kept}={mark}")
        self.position = (mark, 0)


def _beside(node: Node) -> tuple[str, ...]:
    """The fields that must be known to treat `node`."""
    match node:
        case Treated(_, Inside(beside=beside)):
            return tuple(name for name, _ in beside)
        case _:
            return ()


def _prefixed(
    rewrite: Callable[..., tuple[Buffer, int]],
) -> Callable[..., tuple[bytes, Buffer]]:
    def rewritten(*values: Any) -> tuple[bytes, Buffer]:
        body, length = rewrite(*values)
        return length.to_bytes(4, "little"), body

    return rewritten
