"""Values of calls as deterministic CBOR (docs/spec/compact.md). Pure.

A value has exactly one encoding: shortest heads, doubles in eight bytes, members of a struct sorted
by their encoded names. What XML-RPC cannot carry is refused here too: a parameter that one node
sets in this form, another reads as XML. Instances, `Binary` and the like are what the standard
library makes of them.
"""

import math
import re
import struct
import xmlrpc.client
from collections.abc import Callable, Iterable
from datetime import datetime
from typing import Any, Final
from xml.parsers import expat

from ca.encoding import head
from rossec.ros.xmlwrite import EncodedList

DEPTH_LIMIT: Final = 40  # nested arrays and structs of one value, as of XML-RPC
ITEM_BYTES: Final = 16  # of a unit's limit for each value: no more of them fit an XML-RPC body
UINT, NEGATIVE, BYTES, TEXT, ARRAY, MAP = 0, 0x20, 0x40, 0x60, 0x80, 0xA0
FALSE, TRUE, NULL, DOUBLE = b"\xf4", b"\xf5", b"\xf6", b"\xfb"
INTS: Final = range(-(2**31), 2**31)
TIME_HEAD: Final = b"\xa1\x00\x71"  # {0: text of 17 bytes}: no struct has a number as a name
UNCARRIED: Final = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ufffe\uffff]")
"""Characters that XML 1.0 has no form for."""
_CONTROL: Final = "a control character; send such text as bytes"
NAN: Final = b"\xfb\x7f\xf8" + bytes(6)
_TEXT_HEADS: Final = tuple(head(TEXT, size) for size in range(256))
_UINTS: Final = tuple(head(UINT, number) for number in range(256))


class Pieces(list[bytes]):
    """What is written: one piece for each value, and `more` values in pieces encoded ahead."""

    __slots__ = ("more",)

    def __init__(self, pieces: Iterable[bytes] = ()) -> None:
        super().__init__(pieces)
        self.more = 0

    @property
    def values(self) -> int:
        """How many values there are."""
        return len(self) + self.more


def put(value: object, out: Pieces, depth: int = DEPTH_LIMIT) -> None:
    """Append the pieces of `value` to `out`: one for each value in it.

    Raises:
        TypeError, ValueError, OverflowError: it cannot be carried.
    """
    kind = type(value)
    if kind is str:
        out.append(text(value))  # type: ignore[arg-type]
        return
    writer = _WRITERS.get(kind)
    if writer is None:
        writer = _put_foreign
    writer(value, out, depth)


def encoded(value: object, depth: int = DEPTH_LIMIT) -> bytes:
    """`value` alone; see `put`."""
    out = Pieces()
    put(value, out, depth)
    return b"".join(out)


def text(value: str) -> bytes:
    """A string.

    Raises:
        ValueError: XML-RPC has no form for one of its characters.
    """
    if not value.isprintable() and UNCARRIED.search(value) is not None:
        raise ValueError(_CONTROL)
    raw = value.encode()
    size = len(raw)
    return (_TEXT_HEADS[size] if size < 256 else head(TEXT, size)) + raw


def number(value: int) -> bytes:
    """An integer of 32 bits.

    Raises:
        OverflowError: it has more.
    """
    if 0 <= value < 256:
        return _UINTS[value]
    if value not in INTS:
        raise OverflowError("int exceeds XML-RPC limits")
    return head(UINT, value) if value >= 0 else head(NEGATIVE, ~value)


def encode_ahead(value: EncodedList) -> EncodedList:
    """Encode a list that will be sent often, in both forms, now rather than with an answer."""
    out = Pieces()
    _put_encoded(value, out, DEPTH_LIMIT)
    _ = value.text
    return value


def _put_int(value: Any, out: Pieces, _depth: int) -> None:
    out.append(number(value))


def _put_bool(value: Any, out: Pieces, _depth: int) -> None:
    out.append(TRUE if value else FALSE)


def _put_float(value: Any, out: Pieces, _depth: int) -> None:
    out.append(NAN if math.isnan(value) else struct.pack(">Bd", 0xFB, value))


def _put_bytes(value: Any, out: Pieces, _depth: int) -> None:
    out.append(head(BYTES, len(value)) + value)


def _put_time(value: Any, out: Pieces, _depth: int) -> None:
    written = (
        f"{value.year:04}{value.month:02}{value.day:02}"
        f"T{value.hour:02}:{value.minute:02}:{value.second:02}"
    )
    out.append(TIME_HEAD + written.encode())


def _put_array(value: Any, out: Pieces, depth: int) -> None:
    depth = _deeper(depth)
    out.append(head(ARRAY, len(value)))
    for item in value:
        kind = type(item)
        if kind is str:  # the usual ones first
            out.append(text(item))
        elif kind is EncodedList and item.compact is not None:
            out.append(item.compact)
            out.more += item.pieces - 1
        else:
            put(item, out, depth)


def _put_encoded(value: Any, out: Pieces, depth: int) -> None:
    """A list that does not change: its pieces are joined once, and counted.

    Its depth is not known: lists that are encoded ahead are flat.
    """
    if value.compact is None:
        pieces = Pieces()
        _put_array(value, pieces, depth)
        value.compact, value.pieces = b"".join(pieces), pieces.values
    out.append(value.compact)
    out.more += value.pieces - 1


def _put_struct(value: Any, out: Pieces, depth: int) -> None:
    depth = _deeper(depth)
    out.append(head(MAP, len(value)))
    members = [(text(_name(name)), below) for name, below in value.items()]
    members.sort(key=_first)
    for name, below in members:
        out.append(name)
        put(below, out, depth)


def _put_foreign(value: object, out: Pieces, depth: int) -> None:
    """What the standard library makes of it; a plain value, then."""
    try:
        (plain,), _ = xmlrpc.client.loads(
            xmlrpc.client.dumps((value,)),  # type: ignore[arg-type]
            use_builtin_types=True,
        )
    except expat.ExpatError as error:  # no ValueError; the library escapes no control characters
        raise ValueError(_CONTROL) from error
    put(plain, out, depth)


def _first(member: tuple[bytes, object]) -> bytes:
    return member[0]


def _name(name: object) -> str:
    if not isinstance(name, str):
        raise TypeError("dictionary key must be string")
    return name


def _deeper(depth: int) -> int:
    if depth == 0:
        raise ValueError(f"values nested deeper than {DEPTH_LIMIT}")
    return depth - 1


_WRITERS: Final[dict[type, Callable[[Any, Pieces, int], None]]] = {
    int: _put_int,
    bool: _put_bool,
    float: _put_float,
    bytes: _put_bytes,
    bytearray: _put_bytes,
    datetime: _put_time,
    list: _put_array,
    tuple: _put_array,
    dict: _put_struct,
    EncodedList: _put_encoded,
}
