"""Bodies of resources to ROS messages and back, by the layout that filters use too. Pure.

A body is a message as ROS serializes it, or one deterministic CBOR map with every field by name:
numbers, text strings, byte strings for arrays of octets, arrays, maps for nested messages, `[secs,
nsecs]` for times. Everything else is refused: a missing field as well as an unknown one, so that
both sides mean the same.
"""

import struct
from typing import Final

from ca.encoding import Value, decode, encode
from ca.errors import EncodingError
from grants.filters.layout import PRIMITIVES, Array, Layout, Primitive, Struct, Text, Type
from rossec.border.links import CBOR_BODY
from rossec.border.quotas import MAX_BODY
from rossec.errors import BodyRefused

_COUNT: Final = struct.Struct("<I")
_OCTETS: Final = frozenset({"uint8", "char"})
_PAIRS: Final = frozenset({"time", "duration"})
_FLOATS: Final = frozenset("fd")
_BOOL: Final = PRIMITIVES["bool"]


def to_ros(body: bytes, form: int, layout: Layout) -> bytes:
    """The ROS message in the body of a resource.

    Raises:
        BodyRefused: not exactly one message of the type, or too long.
    """
    if len(body) > MAX_BODY:
        raise BodyRefused(f"a body of {len(body)} octets, at most {MAX_BODY}")
    if form != CBOR_BODY:
        _check_whole(body, layout)
        return body
    try:
        value = decode(body, limit=MAX_BODY)
    except EncodingError as error:
        raise BodyRefused(f"a body that is not CBOR: {error}") from None
    pieces: list[bytes] = []
    _write(value, layout.root, layout.type_name, pieces)
    return b"".join(pieces)


def from_ros(message: bytes, form: int, layout: Layout) -> bytes:
    """The body for a ROS message.

    Raises:
        BodyRefused: too long, or bytes that are not one message of the type.
    """
    if form != CBOR_BODY:
        body = message
        _check_whole(message, layout)
    else:
        value, end = _read(message, 0, layout.root)
        _check_end(message, end, layout)
        try:
            body = encode(value)
        except EncodingError as error:
            raise BodyRefused(f"a message that CBOR cannot carry: {error}") from None
    if len(body) > MAX_BODY:
        raise BodyRefused(f"a message of {len(body)} octets, at most {MAX_BODY}")
    return body


def _check_whole(message: bytes, layout: Layout) -> None:
    _check_end(message, _read(message, 0, layout.root)[1], layout)


def _check_end(message: bytes, end: int, layout: Layout) -> None:
    if end != len(message):
        raise BodyRefused(f"{len(message) - end} octets after one {layout.type_name}")


# --- from CBOR


def _write(value: Value, kind: Type, where: str, out: list[bytes]) -> None:
    match kind:
        case Primitive():
            out.append(_primitive(value, kind, where))
        case Text():
            if not isinstance(value, str):
                raise BodyRefused(f"{where} is not text")
            data = value.encode()
            out += (_COUNT.pack(len(data)), data)
        case Array():
            _write_array(value, kind, where, out)
        case Struct():
            names = [name for name, _ in kind.fields]
            if not isinstance(value, dict) or value.keys() != set(names):
                raise BodyRefused(f"{where} does not have exactly the fields {', '.join(names)}")
            for name, inner in kind.fields:
                _write(value[name], inner, name, out)


def _write_array(value: Value, kind: Array, where: str, out: list[bytes]) -> None:
    is_octets = isinstance(kind.element, Primitive) and kind.element.name in _OCTETS
    if not isinstance(value, bytes if is_octets else list):
        raise BodyRefused(f"{where} is not {'a byte string' if is_octets else 'an array'}")
    elements: bytes | list[Value] = value  # one of them: checked above
    if kind.length is None:
        out.append(_COUNT.pack(len(elements)))
    elif len(elements) != kind.length:
        raise BodyRefused(f"{where} has {len(elements)} elements, not {kind.length}")
    if isinstance(elements, bytes):
        out.append(elements)
        return
    for each in elements:
        _write(each, kind.element, where, out)


def _primitive(value: Value, kind: Primitive, where: str) -> bytes:
    if kind.name in _PAIRS:
        pair = value if isinstance(value, list) and len(value) == len(kind.code) else None
        if pair is None or not all(type(each) is int for each in pair):
            raise BodyRefused(f"{where} is not [secs, nsecs]")
        return _pack(kind, where, *pair)
    if kind is _BOOL:
        if not isinstance(value, bool):
            raise BodyRefused(f"{where} is neither true nor false")
    elif kind.code in _FLOATS:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise BodyRefused(f"{where} is not a number")
    elif type(value) is not int:
        raise BodyRefused(f"{where} is not an integer")
    return _pack(kind, where, value)


def _pack(kind: Primitive, where: str, *values: Value) -> bytes:
    try:
        return struct.pack("<" + kind.code, *values)
    except (struct.error, OverflowError):
        raise BodyRefused(f"{where} is out of the range of {kind.name}") from None


# --- from ROS


def _read(data: bytes, at: int, kind: Type) -> tuple[Value, int]:
    match kind:
        case Primitive():
            return _read_primitive(data, at, kind)
        case Text():
            size, at = _read_count(data, at)
            raw = _slice(data, at, size)
            try:
                return raw.decode(), at + size
            except UnicodeDecodeError:
                raise BodyRefused("a string that is not UTF-8") from None
        case Array():
            return _read_array(data, at, kind)
        case Struct():
            found: dict[int | str, Value] = {}
            for name, inner in kind.fields:
                found[name], at = _read(data, at, inner)
            return found, at


def _read_array(data: bytes, at: int, kind: Array) -> tuple[Value, int]:
    count, at = (kind.length, at) if kind.length is not None else _read_count(data, at)
    if isinstance(kind.element, Primitive) and kind.element.name in _OCTETS:
        return _slice(data, at, count), at + count
    if count > len(data):  # else elements of no size would make a loop that reads nothing
        raise BodyRefused(f"an array of {count} elements in {len(data)} octets")
    values: list[Value] = []
    for _ in range(count):
        value, at = _read(data, at, kind.element)
        values.append(value)
    return values, at


def _read_primitive(data: bytes, at: int, kind: Primitive) -> tuple[Value, int]:
    values = struct.unpack("<" + kind.code, _slice(data, at, kind.size))
    if kind.name in _PAIRS:
        return list(values), at + kind.size
    value = values[0]
    if kind is _BOOL:
        if value > 1:
            raise BodyRefused("a bool that is neither 0 nor 1")
        return bool(value), at + 1
    return value, at + kind.size


def _read_count(data: bytes, at: int) -> tuple[int, int]:
    (count,) = _COUNT.unpack(_slice(data, at, _COUNT.size))
    return count, at + _COUNT.size


def _slice(data: bytes, at: int, size: int) -> bytes:
    found = data[at : at + size]
    if len(found) != size:
        raise BodyRefused("a message that ends early")
    return found
