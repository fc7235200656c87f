"""Generated readers of serialized messages: positions, loops, and safe construction of the source.

The source contains only text made by this module and its users: numbers, and names from a counter.
Values from outside (texts, parameters, functions) are bound in the namespace and referred to by
such a name; field names never appear at all. The namespace has no builtins but the ones listed
here.
"""

import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Final, TypeAlias

from grants.errors import DefinitionRefused, MessageRefused
from grants.filters.layout import Array, Struct, Text, Type

Buffer: TypeAlias = bytes | bytearray | memoryview
Position: TypeAlias = tuple[str, int]  # a variable (or "" for none) and a constant

MAX_LOOPS: Final = 12  # Python itself allows 20 nested blocks

# What the generated code can raise for a message of another layout.
LAYOUT_ERRORS: Final = (struct.error, ValueError, IndexError, OverflowError)


class SourceWriter:
    """Source text under construction, and the values bound to names in it."""

    def __init__(self, arguments: str) -> None:
        self._lines = [f"def generated({arguments}):"]
        self._depth = 1
        self._count = 0
        self._namespace: dict[str, Any] = {
            "__builtins__": {"len": len, "range": range, "ValueError": ValueError, "str": str},
            "U": struct.Struct("<I").unpack_from,
        }

    def new(self, prefix: str) -> str:
        """A unique variable name."""
        self._count += 1
        return f"{prefix}{self._count}"

    def bind(self, value: object) -> str:
        """A name for `value` inside the source."""
        name = self.new("k")
        self._namespace[name] = value
        return name

    def line(self, text: str) -> int:
        """Append one statement; return its number for `replace`."""
        self._lines.append(" " * self._depth + text)
        return len(self._lines) - 1

    def replace(self, number: int, text: str) -> None:
        """Fill in a statement that depends on later ones."""
        line = self._lines[number]
        self._lines[number] = line[: len(line) - len(line.lstrip(" "))] + text

    @property
    def nested(self) -> bool:
        """Whether the next statement is inside a loop or a branch."""
        return self._depth > 1

    @contextmanager
    def block(self, head: str) -> Iterator[None]:
        """The statements under `head`, a loop or a branch."""
        if self._depth > MAX_LOOPS:
            raise DefinitionRefused(f"arrays nested deeper than {MAX_LOOPS}")
        self.line(f"{head}:")
        self._depth += 1
        yield
        self._depth -= 1

    @property
    def text(self) -> str:
        """The whole source."""
        return "\n".join(self._lines) + "\n"

    def compile(self) -> Callable[..., Any]:
        """The compiled function."""
        exec(compile(self.text, "<rossec layout>", "exec"), self._namespace)  # noqa: S102 - only names and offsets from here
        function: Callable[..., Any] = self._namespace["generated"]
        return function


class Cursor:
    """A position in the message `b` that moves over types, writing the code that computes it.

    A position only ever grows, and reading a length beyond the end raises `struct.error`; so
    loops end, and comparing the last position with the length of `b` checks all of them.
    """

    def __init__(self, source: SourceWriter) -> None:
        self.source = source
        self.position: Position = ("", 0)

    def at(self, extra: int = 0) -> str:
        """The position as an expression."""
        return expression(self.position, extra)

    def skip(self, kind: Type) -> None:
        """Move past one value of `kind`."""
        match kind:
            case Struct(size=None, fields=fields):
                for _, member in fields:
                    self.skip(member)
            case Text():
                self.jump(f"{self.at(4)}+U(b,{self.at()})[0]")
            case Array(size=None, element=element):
                self._skip_array(kind, element)
            case _:
                assert kind.size is not None  # noqa: S101 - for the type checker
                self.position = (self.position[0], self.position[1] + kind.size)

    def _skip_array(self, kind: Array, element: Type) -> None:
        if element.size is not None:
            self.jump(f"{self.at(4)}+U(b,{self.at()})[0]*{element.size}")
            return
        with self.each(kind):
            self.skip(element)

    def jump(self, target: str) -> None:
        """Continue at `target`, an expression."""
        name = self.source.new("o")
        self.source.line(f"{name}={target}")
        self.position = (name, 0)

    def count(self, kind: Array) -> str:
        """The number of elements as an expression; moves past the count."""
        if kind.length is not None:
            return str(kind.length)
        name = self.source.new("n")
        self.source.line(f"{name}=U(b,{self.at()})[0]")
        self.position = (self.position[0], self.position[1] + 4)
        return name

    @contextmanager
    def each(self, kind: Array) -> Iterator[None]:
        """A loop over the elements; the cursor is at the element inside, past all of them after."""
        count = self.count(kind)
        with self.times(count, self.mark()):
            yield

    def mark(self) -> str:
        """A variable that holds the position."""
        name = self.source.new("p")
        self.source.line(f"{name}={self.at()}")
        self.position = (name, 0)
        return name

    @contextmanager
    def times(self, count: str, name: str) -> Iterator[None]:
        """A loop that runs `count` times and moves the position in the variable `name`."""
        self.position = (name, 0)
        with self.source.block(f"for _ in range({count})"):
            yield
            self.source.line(f"{name}={self.at()}")
        self.position = (name, 0)


def expression(position: Position, extra: int = 0) -> str:
    """A position, moved by `extra` bytes, as an expression."""
    base, offset = position[0], position[1] + extra
    if not base:
        return str(offset)
    return f"{base}+{offset}" if offset else base


def layout_mismatch(type_name: str) -> MessageRefused:
    """The refusal of a message that does not have the layout of its type."""
    return MessageRefused(
        f"a message that is not a {type_name}: truncated, too long or malformed",
        "the sender's message definition does not describe what it sends",
    )
