"""Messages of a layout made from values by path, and values read back. Pure.

For trying filters: a field that is not given is zero, an array has one element. Paths are those of
filters; `times` are seconds. What does not have the layout is refused, as a message from a peer is.
"""

import struct
from collections.abc import Iterator, Mapping
from typing import Final, TypeAlias

from grants.errors import MessageRefused
from grants.filters.layout import Array, Layout, Primitive, Struct, Text, Type

Value: TypeAlias = int | float | str
_NANO: Final = 10**9


def leaves(layout: Layout) -> dict[str, Primitive | Text]:
    """The fields that hold one value, by path; those of an array by the path of the array."""
    return dict(_leaves(layout.root, ""))


def below(paths: Mapping[str, Primitive | Text], path: str) -> list[str]:
    """The leaves that are the field at `path`, or a part of it."""
    plain = path.replace("[*]", "")
    return [
        leaf
        for leaf in paths
        if leaf.replace("[*]", "") == plain or leaf.replace("[*]", "").startswith(f"{plain}.")
    ]


def serialize(layout: Layout, values: Mapping[str, Value]) -> bytes:
    """A message with these values.

    Raises:
        struct.error, OverflowError, ValueError: a value does not fit its field.
    """
    return b"".join(_write(layout.root, "", values))


def read_back(layout: Layout, message: bytes) -> dict[str, Value | None]:
    """The values of all leaves; of an array the first, None if it is empty.

    Raises:
        MessageRefused: the message does not have the layout.
    """
    found: dict[str, Value | None] = {}
    try:
        end = _read(layout.root, "", message, 0, found)
    except (struct.error, UnicodeDecodeError) as error:
        raise MessageRefused("the message does not have its layout") from error
    if end != len(message):
        raise MessageRefused("the message does not end where its layout ends")
    return {path: found.get(path) for path in leaves(layout)}


def _leaves(kind: Type, path: str) -> Iterator[tuple[str, Primitive | Text]]:
    inner = kind.element if isinstance(kind, Array) else kind
    if isinstance(inner, Struct):
        here = f"{path}[*]." if isinstance(kind, Array) else f"{path}." if path else ""
        for name, member in inner.fields:
            yield from _leaves(member, here + name)
    elif not isinstance(inner, Array):
        yield path, inner


def _member(kind: Array | Struct, path: str, name: str = "") -> str:
    if isinstance(kind, Array):
        return f"{path}[*]" if isinstance(kind.element, Struct) else path
    return f"{path}.{name}" if path else name


def _write(kind: Type, path: str, values: Mapping[str, Value]) -> Iterator[bytes]:
    if isinstance(kind, Struct):
        for name, member in kind.fields:
            yield from _write(member, _member(kind, path, name), values)
    elif isinstance(kind, Array):
        count = 1 if kind.length is None else kind.length
        if kind.length is None:
            yield struct.pack("<I", count)
        yield b"".join(_write(kind.element, _member(kind, path), values)) * count
    elif isinstance(kind, Text):
        text = str(values.get(path, "")).encode()
        yield struct.pack("<I", len(text)) + text
    else:
        yield _packed(kind, values.get(path, 0))


def _count(data: bytes, at: int) -> int:
    return int(struct.unpack_from("<I", data, at)[0])


def _packed(kind: Primitive, value: Value) -> bytes:
    number = float(value) if kind.code in "fd" or len(kind.code) > 1 else int(value)
    if len(kind.code) == 2:  # time, duration
        return struct.pack(f"<{kind.code}", *divmod(round(number * _NANO), _NANO))
    return struct.pack(f"<{kind.code}", number)


def _read(kind: Type, path: str, data: bytes, at: int, found: dict[str, Value | None]) -> int:
    """Read the value at `at`; returns where it ends."""
    if isinstance(kind, Struct):
        for name, member in kind.fields:
            at = _read(member, _member(kind, path, name), data, at, found)
        return at
    if isinstance(kind, Array):
        count = kind.length
        if count is None:
            count, at = _count(data, at), at + 4
        for _ in range(min(count, len(data))):
            at = _read(kind.element, _member(kind, path), data, at, found)
        return at
    if isinstance(kind, Text):
        size = _count(data, at)
        found.setdefault(path, data[at + 4 : at + 4 + size].decode())
        return at + 4 + size
    numbers = struct.unpack_from(f"<{kind.code}", data, at)
    value = numbers[0] + numbers[1] / _NANO if len(numbers) == 2 else numbers[0]
    found.setdefault(path, value)
    return at + kind.size
