"""From the text of a message definition to the layout of its bytes, and generated readers of them.

The text is the `message_definition` field of a TCPROS connection header. It may come from a peer, so every
size is checked before it is used. `Layout.md5` is computed as in genmsg (`genmsg/gentools.py`,
`compute_md5_text`); `Layout.digest` covers all of it.
"""

import hashlib
import re
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from itertools import islice
from typing import Any, Final, TypeAlias, TypeVar

from grants.errors import DefinitionIncomplete, DefinitionRefused, MessageRefused

MAX_TEXT: Final = 256 * 1024  # characters; the largest definition in Debian has 13,000
MAX_DEPTH: Final = 32
MAX_FIELDS: Final = 4096  # with all nested messages expanded
MAX_FIXED: Final = 16 * 1024 * 1024  # bytes of a fixed-size part

SEPARATOR: Final = "=" * 80
_NAME: Final = re.compile(r"[A-Za-z][A-Za-z0-9_]*", re.ASCII)
TYPE_NAME: Final = re.compile(r"[A-Za-z][A-Za-z0-9_]*/[A-Za-z][A-Za-z0-9_]*", re.ASCII)
_FIELD_TYPE: Final = re.compile(
    r"((?:[A-Za-z][A-Za-z0-9_]*/)?[A-Za-z][A-Za-z0-9_]*)(?:\[([0-9]{0,9})\])?", re.ASCII
)
_CONSTANT: Final = re.compile(r"\s*(\S+)\s+([A-Za-z][A-Za-z0-9_]*)\s*=(.*)", re.ASCII)


@dataclass(frozen=True, eq=False)
class Primitive:
    """A fixed-size value: `code` is its little-endian `struct` format without the `<`."""

    name: str
    code: str
    size: int


@dataclass(frozen=True, eq=False)
class Text:
    """A string: a length (uint32) and that many bytes."""

    name: str = "string"
    size: None = None


@dataclass(frozen=True, eq=False)
class Array:
    """`length` elements, or, when it is None, a count (uint32) and that many."""

    element: "Type"
    length: int | None

    @property
    def name(self) -> str:
        return f"{self.element.name}[{'' if self.length is None else self.length}]"

    @cached_property
    def size(self) -> int | None:
        # Bytes on the wire when always the same, else None.
        if self.length == 0:
            # For any element type: a loop over many of these would read nothing and never fail.
            return 0
        if self.length is None or self.element.size is None:
            return None
        return self.length * self.element.size


@dataclass(frozen=True, eq=False)
class Struct:
    """A message: its fields in order of the definition."""

    name: str
    fields: tuple[tuple[str, "Type"], ...]

    @cached_property
    def size(self) -> int | None:
        sizes = [kind.size for _, kind in self.fields]
        known = [size for size in sizes if size is not None]
        return sum(known) if len(known) == len(sizes) else None

    def explain_missing(self, name: str) -> str:
        has = ", ".join(known for known, _ in self.fields) or "no fields"
        return f"no field {name!r} in {self.name} (has {has})"


Type: TypeAlias = Primitive | Text | Array | Struct
_Sized = TypeVar("_Sized", Array, Struct)

PRIMITIVES: Final = {
    name: Primitive(name, code, size)
    for name, code, size in (
        *(("bool", "B", 1), ("char", "B", 1), ("byte", "b", 1), ("int8", "b", 1), ("uint8", "B", 1)),
        *(("int16", "h", 2), ("uint16", "H", 2), ("int32", "i", 4), ("uint32", "I", 4)),
        *(("int64", "q", 8), ("uint64", "Q", 8), ("float32", "f", 4), ("float64", "d", 8)),
        *(("time", "II", 8), ("duration", "ii", 8)),
    )
}
_BUILT_IN: Final[dict[str, Type]] = {**PRIMITIVES, "string": Text()}
_CONSTANT_TYPES: Final = _BUILT_IN.keys() - {"time", "duration"}


@dataclass(frozen=True)
class Layout:
    """The layout of one message type: `md5` is ROS's checksum of the definition.

    `md5_text` is the text the checksum covers: constants and fields, in genmsg's form. `digest`
    (SHA-256, 32 bytes) is equal for layouts with the same fields at the same places.
    """

    type_name: str
    md5: str
    root: Struct
    md5_text: str
    digest: bytes

    def leaves(self, most: int | None = None) -> "dict[str, Primitive | Text]":
        """The fields without fields of their own by path, as in filters; an array as its element."""
        return dict(islice(_leaves(self.root, ""), most))

    @property
    def is_proven(self) -> bool:
        # genmsg omits the brackets of an array of messages from what its md5 covers, so `Vector3[0]` and
        # `Vector3[2]` have one md5 and two layouts.
        kinds = (kind.element if isinstance(kind, Array) else kind for _, kind in self.root.fields)
        return not any(isinstance(kind, Struct) for kind in kinds)


def parse(type_name: str, definition: str) -> Layout:
    """Read a definition text with all it depends on."""
    if len(definition) > MAX_TEXT:
        raise DefinitionRefused(
            f"{len(definition)} characters of definition where at most {MAX_TEXT} are allowed"
        )
    if TYPE_NAME.fullmatch(type_name) is None:
        raise DefinitionRefused(f"not a message type: {type_name[:80]!r}", "package/Type")
    if any("\ud800" <= character <= "\udfff" for character in definition):
        raise DefinitionRefused("a definition with lone surrogates")
    built = _Builder(_sections(type_name, definition)).build(type_name, ())
    return Layout(type_name, built.md5, built.struct, built.md5_text, built.digest)


def _leaves(kind: Type, path: str) -> Iterator[tuple[str, Primitive | Text]]:
    inner = kind.element if isinstance(kind, Array) else kind
    if isinstance(inner, Struct):
        here = f"{path}[*]." if isinstance(kind, Array) else f"{path}." if path else ""
        for name, member in inner.fields:
            yield from _leaves(member, here + name)
    elif not isinstance(inner, Array):
        yield path, inner


def dependencies(type_name: str, definition: str) -> frozenset[str]:
    _, declared = _statements(type_name, definition.split("\n"))
    bases = ((_base(type_name, text)[0], text) for text in declared.values())
    return frozenset(_full_name(type_name, base, text) for base, text in bases if base not in _BUILT_IN)


def service_md5(request: Layout, response: Layout) -> str:
    return _md5(request.md5_text + response.md5_text)


def _sections(type_name: str, definition: str) -> dict[str, list[str]]:
    sections: dict[str, list[str]] = {type_name: []}
    lines = iter(definition.split("\n"))
    current = sections[type_name]
    for line in lines:
        if line == f"{SEPARATOR}\r":
            raise DefinitionRefused(
                "the lines of the definition end with CR LF, as those of a file from Windows",
                "convert the .msg files of its package (dos2unix), and build it again",
            )
        if line != SEPARATOR:
            current.append(line)
            continue
        head = next(lines, "")
        name = head.removeprefix("MSG: ").strip()
        if not head.startswith("MSG: ") or TYPE_NAME.fullmatch(name) is None:
            raise DefinitionRefused(f"expected 'MSG: package/Type', found {head[:80]!r}")
        if name in sections:
            # genpy would use the last, others the first: two layouts for one text.
            raise DefinitionRefused(f"{name} is defined twice")
        current = sections[name] = []
    return sections


@dataclass(frozen=True)
class _Built:
    struct: Struct
    md5_text: str
    md5: str
    leaves: int
    digest: bytes


@dataclass
class _Builder:
    sections: dict[str, list[str]]
    built: dict[str, _Built] = field(default_factory=dict)

    def build(self, name: str, parents: tuple[str, ...]) -> _Built:
        if name not in self.built:
            if name not in self.sections:
                raise DefinitionIncomplete(
                    f"the definition of {name} is missing",
                    "a definition has those of all types it uses, each behind a line of 80 =",
                )
            if name in parents or len(parents) >= MAX_DEPTH:
                raise DefinitionRefused(f"{name} is nested in itself or deeper than {MAX_DEPTH}")
            constants, declared = _statements(name, self.sections[name])
            fields: list[tuple[str, Type]] = []
            lines: list[str] = []
            full_digest = hashlib.sha256(name.encode())
            leaves = 0
            for field_name, text in declared.items():
                kind, digest, count = self._resolve(name, text, (*parents, name))
                fields.append((field_name, kind))
                lines.append(f"{digest} {field_name}")
                full_digest.update(f"\n{self._full_type(kind)} {field_name}".encode())
                leaves += count
                if leaves > MAX_FIELDS:
                    raise DefinitionRefused(f"{name} has more than {MAX_FIELDS} fields")
            md5_text = "\n".join(constants + lines).strip()
            struct = _bounded(Struct(name, tuple(fields)))
            self.built[name] = _Built(struct, md5_text, _md5(md5_text), leaves, full_digest.digest())
        return self.built[name]

    def _full_type(self, kind: Type) -> str:
        match kind:
            case Array(element, length):
                return f"{self._full_type(element)}[{'' if length is None else length}]"
            case Struct(name):
                return f"{name}:{self.built[name].digest.hex()}"
            case _:
                return kind.name

    def _resolve(self, inside: str, text: str, parents: tuple[str, ...]) -> tuple[Type, str, int]:
        base, length = _base(inside, text)
        digest, leaves = text, 1
        if base in _BUILT_IN:
            kind = _BUILT_IN[base]
        else:
            built = self.build(_full_name(inside, base, text), parents)
            kind, digest, leaves = built.struct, built.md5, built.leaves + 1
        if length is not None:
            kind = _bounded(Array(kind, int(length) if length else None))
        return kind, digest, leaves


def _base(inside: str, text: str) -> tuple[str, str | None]:
    matched = _FIELD_TYPE.fullmatch(text)
    if matched is None:
        raise DefinitionRefused(f"not a field type in {inside}: {text[:80]!r}")
    return matched[1], matched[2]


def _full_name(inside: str, base: str, text: str) -> str:
    if "/" in base:
        return base
    if text == "Header":  # not as an array, as in genmsg's `_load_field_line`
        return "std_msgs/Header"
    return f"{inside.split('/', maxsplit=1)[0]}/{base}"


def _statements(name: str, lines: list[str]) -> tuple[list[str], dict[str, str]]:
    constants: list[str] = []
    fields: dict[str, str] = {}
    for line in lines:
        code = line.split("#", maxsplit=1)[0].strip()
        if "=" in code:
            # A string constant runs to the end of the line: `#` is part of its value.
            matched = _CONSTANT.fullmatch(line if code.startswith("string ") else code)
            if matched is None or matched[1] not in _CONSTANT_TYPES:
                raise DefinitionRefused(f"not a constant: {line[:80]!r}", "expected: type NAME=value")
            constants.append(f"{matched[1]} {matched[2]}={matched[3].strip()}")
        elif code:
            kind, field_name = _field(code)
            if field_name in fields:
                raise DefinitionRefused(f"{name} has two fields {field_name!r}")
            fields[field_name] = kind
    return constants, fields


def _field(code: str) -> tuple[str, str]:
    match code.split():
        case [kind, name] if _NAME.fullmatch(name) is not None and "\\" not in kind:
            return kind, name
    if "\\n" in code:
        raise DefinitionRefused(
            f"a backslash and an n in the definition where a line should end: {code[:80]!r}",
            "the program that publishes writes it so: update it, or report it there",
        )
    raise DefinitionRefused(f"not a field: {code[:80]!r}", "expected: type name")


def _bounded(kind: _Sized) -> _Sized:
    if kind.size is not None and kind.size > MAX_FIXED:
        raise DefinitionRefused(f"{kind.name} is larger than {MAX_FIXED} bytes")
    return kind


def _md5(text: str) -> str:
    # ROS's checksum guards against mistakes, not against forgery.
    return hashlib.md5(text.encode(), usedforsecurity=False).hexdigest()


Buffer: TypeAlias = bytes | bytearray | memoryview
Errors: TypeAlias = tuple[type[Exception], ...]
Position: TypeAlias = tuple[str, int]  # a variable (or "" for none) and a constant

MAX_LOOPS: Final = 12  # Python itself allows 20 nested blocks

# What the generated code can raise for a message of another layout.
LAYOUT_ERRORS: Final[Errors] = (struct.error, ValueError, IndexError, OverflowError)


class SourceWriter:
    """Source text under construction, and the values bound to names in it."""

    def __init__(self, arguments: str) -> None:
        self._lines = [f"def generated({arguments}):"]
        self._depth = 1
        self._count = 0
        # The source has only text made here, numbers and names from a counter: values from outside are bound
        # in this namespace, which has no other builtins, and names of fields never appear (ADR 0022).
        self._namespace: dict[str, Any] = {
            "__builtins__": {"len": len, "range": range, "ValueError": ValueError, "str": str},
            "U": struct.Struct("<I").unpack_from,
        }

    def new(self, prefix: str) -> str:
        self._count += 1
        return f"{prefix}{self._count}"

    def bind(self, value: object) -> str:
        """A name for `value` inside the source."""
        name = self.new("k")
        self._namespace[name] = value
        return name

    def line(self, text: str) -> int:
        self._lines.append(" " * self._depth + text)
        return len(self._lines) - 1

    def replace(self, number: int, text: str) -> None:
        line = self._lines[number]
        self._lines[number] = line[: len(line) - len(line.lstrip(" "))] + text

    @property
    def nested(self) -> bool:
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
        return "\n".join(self._lines) + "\n"

    def compile(self, errors: Errors = (), refusal: str = "") -> Callable[..., Any]:
        """The function; where it raises one of `errors`, it does `refusal` instead."""
        # In the function itself: a second one around it costs a small message 0.1 us.
        if errors:
            head, *body = self._lines
            handler = f" except {self.bind(errors)}: {refusal}"
            self._lines = [head, " try:", *(f" {line}" for line in body), handler]
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
        return expression(self.position, extra)

    def skip(self, kind: Type) -> None:
        """Move past one value of `kind`."""
        match kind:
            case Struct(size=None, fields=fields):
                for _, member in fields:
                    self.skip(member)
            case Text():
                self.jump(f"{self.at(4)}+U(b,{self.at()})[0]")
            case Array(size=None, element=element) if element.size is not None:
                self.jump(f"{self.at(4)}+U(b,{self.at()})[0]*{element.size}")
            case Array(size=None, element=element):
                with self.each(kind):
                    self.skip(element)
            case _:
                assert kind.size is not None  # noqa: S101 - for the type checker
                self.position = (self.position[0], self.position[1] + kind.size)

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
