"""From a treated layout to a function on bytes: what is kept is sliced, what is treated is made.

The generated function returns the pieces of the new message in order, for scatter-gather
sending: kept parts are slices of the message (an image is never copied), neighbouring treated
numbers go through one `struct` call, arrays of numbers and arrays of fixed-size messages through
numpy. It raises one of `codegen.MISFIT` when the message does not have the layout.
"""

import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

from grants.codegen import Buffer, Cursor, Position, Source, expression
from grants.layout import Array, Primitive, Type
from grants.tables import table_rewriter
from grants.treatments import Body, Constant, Each, Keep, Node, Numbers, Parts

_UNROLL: Final = range(1, 9)  # fixed arrays of these lengths are cheaper without numpy


def generate(node: Node) -> Callable[[Buffer], list[Buffer]]:
    """The function from a message to the pieces of the treated message."""
    source = Source("b")
    writer = _Writer(source)
    writer.write(node)
    source.line(f"if len(b)!={writer.at()}: raise ValueError")
    source.line(f"return [{','.join(writer.finish())}]")
    return source.compile()


@dataclass
class _Run:
    """Treated values side by side: one unpack, one pack."""

    start: Position
    end: Position
    items: list[tuple[Primitive, Numbers] | bytes] = field(default_factory=list)


class _Writer(Cursor):
    """A cursor that collects pieces; `_kept` is where the part not yet collected begins."""

    def __init__(self, source: Source) -> None:
        super().__init__(source)
        self._kept: Position = ("", 0)
        self._run: _Run | None = None
        self._pieces: list[str] = []

    def write(self, node: Node) -> None:
        match node:
            case Keep(kind):
                self.skip(kind)
            case Parts(_, parts):
                for part in parts:
                    self.write(part)
            case Each(kind, element):
                self._array(kind, element)
            case _:
                self._treated(node.kind, node.treatment)

    def finish(self) -> list[str]:
        """All pieces as expressions, the rest of the message last."""
        self._flush()
        pieces, self._pieces = self._pieces, []
        pieces.append(f"b[{expression(self._kept)}:]")
        return pieces

    def _treated(self, kind: Type, treatment: Constant | Numbers | Body) -> None:
        match treatment:
            case Constant(data):
                if kind.size is None:
                    self._replace(kind, self.source.bind(data))
                else:
                    self._extend(kind, data)
            case Numbers():
                assert isinstance(kind, Primitive)  # noqa: S101
                self._extend(kind, (kind, treatment))
            case _:
                self._body(kind, treatment.rewrite)

    def _replace(self, kind: Type, *pieces: str) -> None:
        """Other pieces in place of one value of `kind`."""
        self._flush()
        self.skip(kind)
        self._pieces.extend(pieces)
        self._kept = self.position

    def _body(self, kind: Type, rewrite: Callable[[Buffer], tuple[Buffer, int]]) -> None:
        start = self.position
        self._flush()
        self.skip(kind)
        head, body = self.source.new("h"), self.source.new("c")
        content = f"b[{expression(start, 4)}:{self.at()}]"
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
        outer, self._pieces, self._kept = self._pieces, [], (kept, 0)
        with self.each(kind):
            self.write(element)
            self._close()
            self.source.line(f"{pieces}+=[{','.join(self._pieces)}]")
            self.source.line(f"{kept}={expression(self._kept)}")
        self._pieces, self._kept = [*outer, f"*{pieces}"], (kept, 0)


def _prefixed(
    rewrite: Callable[[Buffer], tuple[Buffer, int]],
) -> Callable[[Buffer], tuple[bytes, Buffer]]:
    def rewritten(content: Buffer) -> tuple[bytes, Buffer]:
        body, length = rewrite(content)
        return length.to_bytes(4, "little"), body

    return rewritten
