"""What a thing has: its list of resources (RFC 6690), as topics and services, and their bodies. Pure.

`</t>;rt="ros.pub";if="sensor_msgs/Temperature";title="~temperature";ct=60` is a topic that the thing
publishes. A name that begins with `~` lies below the thing's own name; others are absolute. Whether it
may have that name its grants say. A body is a message as ROS serializes it, or one deterministic CBOR
map with every field by name: numbers, text strings, byte strings for arrays of octets, arrays, maps for
nested messages, `[secs, nsecs]` for times. Everything else is refused: a missing field as well as an
unknown one, so that both sides mean the same.
"""

import re
import struct
from dataclasses import dataclass
from typing import Final

from ca.encoding import Value, decode, encode
from ca.errors import EncodingError, NameRefused
from ca.names import check_name
from grants.filters.layout import PRIMITIVES, Array, Layout, Primitive, Struct, Text, Type
from rossec.border.conversations import MAX_BODY, MAX_OBSERVATIONS, MAX_RESOURCES
from rossec.errors import BodyRefused, ThingError

PUBLISHER, SUBSCRIBER, SERVICE = "ros.pub", "ros.sub", "ros.srv"
KINDS: Final = frozenset({PUBLISHER, SUBSCRIBER, SERVICE})
MAX_LIST: Final = 8192
MAX_PATH: Final = 64
ROS_BODY: Final = 65001  # content format: a ROS message as it is serialized
CBOR_BODY: Final = 60  # content format: a CBOR map of the fields
FORMATS: Final = frozenset({ROS_BODY, CBOR_BODY})
_TYPE: Final = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,99}/[A-Za-z][A-Za-z0-9_]{0,99}", re.ASCII)
_SEGMENT: Final = re.compile(r"[A-Za-z0-9_.-]{1,32}", re.ASCII)
_VALUE: Final = r'"[^"\\]*"|[^",;\s\\]*'
_PARAMETER: Final = re.compile(rf';\s*([^,;="\s]+)(?:=({_VALUE}))?')
_LINK: Final = re.compile(rf'\s*<([^<>"]*)>((?:;\s*[^,;="\s]+(?:=(?:{_VALUE}))?)*)\s*(?:,|\Z)')
_COUNT: Final = struct.Struct("<I")
_OCTETS: Final = frozenset({"uint8", "char"})
_PAIRS: Final = frozenset({"time", "duration"})
_FLOATS: Final = frozenset("fd")
_BOOL: Final = PRIMITIVES["bool"]


@dataclass(frozen=True, slots=True)
class Resource:
    """One resource of a thing."""

    kind: str  # `PUBLISHER`, `SUBSCRIBER` or `SERVICE`
    path: tuple[str, ...]
    type: str  # of ROS
    name: str  # of the topic or the service, absolute
    format: int  # the content format of its bodies


def read_links(data: bytes, thing: str) -> list[Resource]:
    if len(data) > MAX_LIST:
        raise ThingError(f"a list of resources of {len(data)} octets, at most {MAX_LIST}")
    try:
        text = data.decode("ascii")
    except UnicodeDecodeError:
        raise ThingError("a list of resources that is not ASCII") from None
    links: list[tuple[str, str]] = []
    end = 0
    while end < len(text):
        match = _LINK.match(text, end)
        if match is None or len(links) > MAX_RESOURCES:
            raise ThingError(f"not a list of links at character {end}")
        links.append((match[1], match[2]))
        end = match.end()
    found = [each for each in (_resource(*link, thing) for link in links) if each]
    if sum(each.kind == PUBLISHER for each in found) > MAX_OBSERVATIONS:
        raise ThingError(f"a thing publishes at most {MAX_OBSERVATIONS} topics")
    if len({(each.kind, each.name) for each in found}) != len(found):
        raise ThingError("two resources of a thing have one name")
    if len({each.path for each in found}) != len(found):
        raise ThingError("one resource of a thing is listed twice")
    return found


def _resource(target: str, parameters: str, thing: str) -> Resource | None:
    values: dict[str, str] = {}
    for match in _PARAMETER.finditer(parameters):
        if match[1] in values:
            raise ThingError(f"the link to {target!a} says {match[1]!a} twice")
        values[match[1]] = (match[2] or "").strip('"')
    kind = values.get("rt", "")
    if kind not in KINDS:
        return None
    type_name = values.get("if", "")
    if _TYPE.fullmatch(type_name) is None:
        raise ThingError(f"{type_name!a} is not a ROS type", "package/Type")
    path = tuple(target.removeprefix("/").split("/"))
    good = all(_SEGMENT.fullmatch(each) and each not in {".", ".."} for each in path)
    if not target.startswith("/") or len(target) > MAX_PATH or not good:
        raise ThingError(f"{target[:MAX_PATH]!a} is not the path of a resource")
    title = values.get("title", "")
    try:
        name = check_name(f"{thing}/{title[1:]}" if title.startswith("~") else title)
    except NameRefused as error:
        raise ThingError(f"the name {title!a}: {error}", "~name, or /absolute") from None
    form = values.get("ct", str(ROS_BODY))
    if form not in {str(each) for each in FORMATS}:
        raise ThingError(f"content format {form!a}", f"{ROS_BODY} or {CBOR_BODY}")
    return Resource(kind, path, type_name, name, int(form))


def to_ros(body: bytes, form: int, layout: Layout) -> bytes:
    if len(body) > MAX_BODY:
        raise BodyRefused(f"a body of {len(body)} octets, at most {MAX_BODY}")
    if form != CBOR_BODY:
        _read_whole(body, layout)
        return body
    try:
        value = decode(body, limit=MAX_BODY)
    except EncodingError as error:
        raise BodyRefused(f"a body that is not CBOR: {error}") from None
    pieces: list[bytes] = []
    _write(value, layout.root, layout.type_name, pieces)
    return b"".join(pieces)


def from_ros(message: bytes, form: int, layout: Layout) -> bytes:
    value, body = _read_whole(message, layout), message
    if form == CBOR_BODY:
        try:
            body = encode(value)
        except EncodingError as error:
            raise BodyRefused(f"a message that CBOR cannot carry: {error}") from None
    if len(body) > MAX_BODY:
        raise BodyRefused(f"a message of {len(body)} octets, at most {MAX_BODY}")
    return body


def _read_whole(message: bytes, layout: Layout) -> Value:
    value, end = _read(message, 0, layout.root)
    if end != len(message):
        raise BodyRefused(f"{len(message) - end} octets after one {layout.type_name}")
    return value


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


def _read(data: bytes, at: int, kind: Type) -> tuple[Value, int]:
    match kind:
        case Primitive():
            values = struct.unpack("<" + kind.code, _slice(data, at, kind.size))
            if kind is _BOOL and values[0] > 1:
                raise BodyRefused("a bool that is neither 0 nor 1")
            value = list(values) if kind.name in _PAIRS else bool(values[0]) if kind is _BOOL else values[0]
            return value, at + kind.size
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


def _read_count(data: bytes, at: int) -> tuple[int, int]:
    (count,) = _COUNT.unpack(_slice(data, at, _COUNT.size))
    return count, at + _COUNT.size


def _slice(data: bytes, at: int, size: int) -> bytes:
    found = data[at : at + size]
    if len(found) != size:
        raise BodyRefused("a message that ends early")
    return found
