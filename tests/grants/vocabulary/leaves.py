"""Messages as trees: every leaf of a type changed alone, drastically, and the bytes of each.

A mutation has a key that says what it changes, by the type that declares it and the field that
this is in: a field (`geometry_msgs/Pose.position > geometry_msgs/Point.x`; of an array of values
also its length and order), or the number (`[#]`) or order (`[~]`) of the messages of an array.
Changes that only a broken message would have, as a
picture's size without its data, are not made.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from grants.filters.layout import Array, Layout, Primitive, Struct, Text, Type

PICTURE = "sensor_msgs/Image"
_SIZES = {"height": 48, "width": 48, "step": 48, "encoding": b"mono8"}


@dataclass
class Mutation:
    """One message that differs from the first in what `key` names."""

    key: str
    message: bytes


def base(layout: Layout) -> bytes:
    """The message that mutations differ from: all arrays have two elements that differ."""
    return _bytes(layout.root, _value(layout.root, 0))


def mutations(layout: Layout) -> Iterator[Mutation]:
    """Every leaf changed alone, in the first element of each array and in the last."""
    whole = _value(layout.root, 0)
    first = _bytes(layout.root, whole)
    for key, changed in _changes(layout.root, whole):
        message = _bytes(layout.root, changed)
        if message != first:
            yield Mutation(key, message)


def _value(kind: Type, salt: int) -> Any:
    match kind:
        case Struct(name, fields):
            found = {field: _value(k, salt + n) for n, (field, k) in enumerate(fields)}
            if name == PICTURE:
                found |= _SIZES | {"data": [(at * 7 + salt) % 256 for at in range(48 * 48)]}
            return found
        case Array(element, length):
            return [_value(element, salt + 5 * n) for n in range(2 if length is None else length)]
        case Text():
            return b"text%d" % (salt % 10)
        case Primitive(code=code):
            return [_number(c, salt) for c in code]
    raise AssertionError(kind)


def _number(code: str, salt: int) -> float:
    return salt % 2 if code == "?" else 1 + salt % 7


def _other(kind: Type, value: Any) -> list[Any]:
    match kind:
        case Text():
            return [b"quite another text", b""]
        case Primitive(code="?"):
            return [[1 - value[0]]]
        case Primitive(code=code) if code in ("f", "d"):
            return [[value[0] + 30_000.0], [value[0] - 7.5], [-value[0] / 3]]
        case Primitive(code=code):
            return [[100 if c in "bB" else 10_000 for c in code], [0 for _ in code]]
        case _:
            raise AssertionError(kind)


def _changes(kind: Struct, value: dict[str, Any], within: str = "") -> Iterator[tuple[str, dict[str, Any]]]:
    for field, member in kind.fields:
        if kind.name == PICTURE and field in _SIZES:
            continue
        key = f"{within} > {kind.name}.{field}" if within else f"{kind.name}.{field}"
        for found, changed in _of(key, member, value[field], kind.name == PICTURE):
            yield found, value | {field: changed}


def _of(key: str, kind: Type, value: Any, is_picture: bool) -> Iterator[tuple[str, Any]]:
    if isinstance(kind, Struct):
        yield from _changes(kind, value, key.rpartition(" > ")[2])
    elif isinstance(kind, Array):
        yield from _of_array(key, kind, value, is_picture)
    else:
        yield from ((key, other) for other in _other(kind, value))


def _of_array(key: str, kind: Array, value: list[Any], is_picture: bool) -> Iterator[tuple[str, Any]]:
    inner = kind.element
    is_messages = isinstance(inner, Struct)
    if kind.length is None and not (is_picture and key.endswith(".data")):
        number = f"{key}[#]" if is_messages else key
        yield from ((number, changed) for changed in ([], value[:1], [*value, value[0]]))
    if len(value) > 1:
        yield f"{key}[~]" if is_messages else key, value[::-1]
    for at in dict.fromkeys((0, len(value) - 1) if value else ()):
        for found, changed in _of(key, inner, value[at], is_picture):
            yield found, [*value[:at], changed, *value[at + 1 :]]
    if is_picture and key.endswith(".data"):
        yield from ((key, [light for _ in value]) for light in (0, 255))


def _bytes(kind: Type, value: Any) -> bytes:
    match kind:
        case Struct(_, fields):
            return b"".join(_bytes(member, value[field]) for field, member in fields)
        case Array(element, length):
            head = b"" if length is not None else struct.pack("<I", len(value))
            return head + b"".join(_bytes(element, each) for each in value)
        case Text():
            return struct.pack(f"<I{len(value)}s", len(value), value)
        case Primitive(code=code):
            values = value if isinstance(value, list) else [value]
            return struct.pack(f"<{code}", *values)
    raise AssertionError(kind)
