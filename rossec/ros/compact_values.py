"""Values of calls as deterministic CBOR, written and read strictly (docs/spec/compact.md). Pure.

A value has exactly one encoding: shortest heads, doubles in eight bytes, members of a struct sorted
by their encoded names; what is read otherwise is refused where it stands, in one pass. What XML-RPC
cannot carry is refused here too: a parameter that one node sets in this form, another reads as XML.
Instances, `Binary` and the like are what the standard library makes of them. It is read by hand, not
by `cbor2`, which reads more than is allowed here: its values would have to be walked, encoded again
and compared (docs/decisions/0045-compact-calls.md has the figures).
"""

import math
import re
import struct
import xmlrpc
import xmlrpc.client
from collections.abc import Callable, Generator, Iterable
from datetime import datetime
from operator import itemgetter
from typing import Any, Final
from xml.parsers import expat

from ca.encoding import head
from rossec.errors import CompactRefused
from rossec.ros.xmlrpc import EncodedList

DEPTH_LIMIT: Final = 40  # nested arrays and structs of one value, as of XML-RPC
ITEM_BYTES: Final = 16  # of a unit's limit for each value: no more of them fit an XML-RPC body
UINT, NEGATIVE, BYTES, TEXT, ARRAY, MAP = 0, 0x20, 0x40, 0x60, 0x80, 0xA0
FALSE, TRUE, NULL, DOUBLE = b"\xf4", b"\xf5", b"\xf6", b"\xfb"
INTS: Final = range(-(2**31), 2**31)
STEP: Final = 1024  # values that are read at a time: about 1 ms
MALFORMED: Final = (IndexError, UnicodeDecodeError)
TIME_HEAD: Final = b"\xa1\x00\x71"  # {0: text of 17 bytes}: no struct has a number as a name
# Characters that XML 1.0 has no form for
UNCARRIED: Final = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ufffe\uffff]")
_CONTROL: Final = "a control character; send such text as bytes"
NAN: Final = b"\xfb\x7f\xf8" + bytes(6)
_TEXT_HEADS: Final = tuple(head(TEXT, size) for size in range(256))
_UINTS: Final = tuple(head(UINT, number) for number in range(256))
_WIDTHS: Final = {24: (1, 24), 25: (2, 1 << 8), 26: (4, 1 << 16)}  # bytes, and least value
_INT_MAX: Final = 2**31 - 1
_TIME_SIZE: Final = 17
_TIME: Final = re.compile(rb"(\d{4})(\d\d)(\d\d)T(\d\d):(\d\d):(\d\d)")
_TYPE: Final = 0xE0
_TRUTH: Final = {FALSE: False, TRUE: True}


class Pieces(list[bytes]):
    __slots__ = ("more",)

    def __init__(self, pieces: Iterable[bytes] = ()) -> None:
        super().__init__(pieces)
        self.more = 0

    @property
    def values(self) -> int:
        return len(self) + self.more


def put(value: object, out: Pieces, depth: int = DEPTH_LIMIT) -> None:
    kind = type(value)
    if kind is str:
        out.append(encoded_text(value))  # type: ignore[arg-type]
    else:
        _WRITERS.get(kind, _put_foreign)(value, out, depth)


def encoded(value: object, depth: int = DEPTH_LIMIT) -> bytes:
    out = Pieces()
    put(value, out, depth)
    return b"".join(out)


def encoded_text(value: str) -> bytes:
    if not value.isprintable() and UNCARRIED.search(value) is not None:
        raise ValueError(_CONTROL)
    raw = value.encode()
    size = len(raw)
    return (_TEXT_HEADS[size] if size < 256 else head(TEXT, size)) + raw


def encoded_number(value: int) -> bytes:
    if 0 <= value < 256:
        return _UINTS[value]
    if value not in INTS:
        raise OverflowError("int exceeds XML-RPC limits")
    return head(UINT, value) if value >= 0 else head(NEGATIVE, ~value)


def encode_ahead(value: EncodedList) -> EncodedList:
    # Encode a list that will be sent often, in both forms, now rather than with an answer.
    out = Pieces()
    _put_encoded(value, out, DEPTH_LIMIT)
    _ = value.text
    return value


def _put_time(value: Any, out: Pieces, _depth: int) -> None:
    date = f"{value.year:04}{value.month:02}{value.day:02}"
    out.append(TIME_HEAD + f"{date}T{value.hour:02}:{value.minute:02}:{value.second:02}".encode())


def _put_array(value: Any, out: Pieces, depth: int) -> None:
    depth = _deeper(depth)
    out.append(head(ARRAY, len(value)))
    for item in value:
        kind = type(item)
        if kind is str:  # the usual ones first
            out.append(encoded_text(item))
        elif kind is EncodedList and item.compact is not None:
            out.append(item.compact)
            out.more += item.pieces - 1
        else:
            put(item, out, depth)


def _put_encoded(value: Any, out: Pieces, depth: int) -> None:
    # A list that does not change: its pieces are joined once, and counted.
    # Its depth is not known: lists that are encoded ahead are flat.
    if value.compact is None:
        pieces = Pieces()
        _put_array(value, pieces, depth)
        value.compact, value.pieces = b"".join(pieces), pieces.values
    out.append(value.compact)
    out.more += value.pieces - 1


def _put_struct(value: Any, out: Pieces, depth: int) -> None:
    depth = _deeper(depth)
    out.append(head(MAP, len(value)))
    members = []
    for name, below in value.items():
        if not isinstance(name, str):
            raise TypeError("dictionary key must be string")
        members.append((encoded_text(name), below))
    members.sort(key=itemgetter(0))
    for name, below in members:
        out.append(name)
        put(below, out, depth)


def _put_foreign(value: object, out: Pieces, depth: int) -> None:
    try:
        (plain,), _ = xmlrpc.client.loads(
            xmlrpc.client.dumps((value,)),  # type: ignore[arg-type]
            use_builtin_types=True,
        )
    except expat.ExpatError as error:  # no ValueError; the library escapes no control characters
        raise ValueError(_CONTROL) from error
    put(plain, out, depth)


def _deeper(depth: int) -> int:
    if depth == 0:
        raise ValueError(f"values nested deeper than {DEPTH_LIMIT}")
    return depth - 1


# Called with the value, the pieces it is put into, and how deep it may nest.
_WRITERS: Final[dict[type, Callable[[Any, Pieces, int], None]]] = {
    int: lambda value, out, _: out.append(encoded_number(value)),
    bool: lambda value, out, _: out.append(TRUE if value else FALSE),
    float: lambda value, out, _: out.append(NAN if math.isnan(value) else struct.pack(">Bd", 0xFB, value)),
    bytes: lambda value, out, _: out.append(head(BYTES, len(value)) + value),
    bytearray: lambda value, out, _: out.append(head(BYTES, len(value)) + value),
    datetime: _put_time,
    list: _put_array,
    tuple: _put_array,
    dict: _put_struct,
    EncodedList: _put_encoded,
}


class _Open:
    __slots__ = ("depth", "found", "left", "name", "previous", "values")

    def __init__(self, left: int, depth: int, *, named: bool = False) -> None:
        self.left = left
        self.depth = depth
        self.values: list[object] = []
        self.found: dict[str, object] | None = {} if named else None
        self.previous = b""  # the encoded name of the last member
        self.name = ""

    def put(self, value: object) -> None:
        if self.found is None:
            self.values.append(value)
        else:
            self.found[self.name] = value


class CompactReader:
    """Reads the values of one unit, from byte `at` on.

    Raises (every method):
        CompactRefused: the bytes are not what is wanted, or not in its one form.
        IndexError, UnicodeDecodeError: it ends too early, or a text is not UTF-8 (`MALFORMED`).
    """

    __slots__ = ("_data", "_items_left", "at")

    def __init__(self, data: bytes, limit: int, at: int = 0) -> None:
        self._data = data
        self._items_left = limit // ITEM_BYTES
        self.at = at

    @property
    def at_end(self) -> bool:
        return self.at == len(self._data)

    def items(self, count: int, depth: int = DEPTH_LIMIT) -> list[object]:
        self._count(count)
        data, at = self._data, self.at
        values: list[object] = []
        append = values.append
        for _ in range(count):
            first = data[at]
            if 0x60 <= first < 0x79:  # short texts first; one that is cut off is noticed later
                at += 1
                size = first - 0x60
                if size == 24:
                    size = data[at]
                    at += 1
                    if size < 24:
                        raise CompactRefused("a unit whose numbers are not in their shortest form")
                end = at + size
                text = str(data[at:end], "utf-8")
                if not text.isprintable():
                    _check_text(text)
                append(text)
                at = end
            elif first < 24:
                append(first)
                at += 1
            else:
                self.at = at
                append(_READERS[first >> 5](self, depth))
                at = self.at
        self.at = at
        return values

    def steps(self, count: int, depth: int = DEPTH_LIMIT) -> Generator[None, None, list[object]]:
        begun = _Open(self._count(count), depth)
        stack = [begun]
        taken = 0
        while stack:
            top = stack[-1]
            if top.left == 0:
                stack.pop()
                continue
            top.left -= 1
            inner = self._step(top)
            if inner is not None:
                stack.append(inner)
            taken += 1
            if taken % STEP == 0:
                yield
        return begun.values

    def _step(self, top: _Open) -> _Open | None:
        # Read one value of `top`; of an array or a map only the head, which is returned.
        if top.found is not None:
            top.name, top.previous = self._next_name(top.depth, top.previous)
            self._count(1)
        data, at = self._data, self.at
        major = data[at] & _TYPE
        if major == ARRAY:
            inner = _Open(self._count(self.head(ARRAY)), _inside(top.depth))
            top.put(inner.values)
            return inner
        if major == MAP and not data.startswith(TIME_HEAD, at):
            inner = _Open(self.head(MAP), _inside(top.depth), named=True)
            top.put(inner.found)
            return inner
        top.put(_READERS[major >> 5](self, top.depth))
        return None

    def _count(self, count: int) -> int:
        self._items_left -= count
        if self._items_left < 0:
            raise CompactRefused("a unit with too many values")
        return count

    def skip(self, item: bytes) -> bool:
        found = self._data.startswith(item, self.at)
        self.at += found
        return found

    def head(self, major: int) -> int:
        # The number in the next head, which must be of this type.
        value = self._data[self.at] ^ major
        self.at += 1
        if value < 24:
            return value
        width, least = _WIDTHS.get(value, (0, 0))
        if not width:
            raise CompactRefused("a unit with an item of another type or size")
        value = int.from_bytes(self._take(width))
        if value < least:  # RFC 8949 section 4.2.1: one form for each number
            raise CompactRefused("a unit whose numbers are not in their shortest form")
        return value

    def _take(self, size: int) -> bytes:
        begin = self.at
        self.at = end = begin + size
        if end > len(self._data):
            raise CompactRefused("a unit that ends too early")
        return self._data[begin:end]

    def _text(self, _depth: int) -> str:
        text = str(self._take(self.head(TEXT)), "utf-8")
        if not text.isprintable():
            _check_text(text)
        return text

    def _map(self, depth: int) -> object:
        if self._data.startswith(TIME_HEAD, self.at):
            self.at += len(TIME_HEAD)
            written = self._take(_TIME_SIZE)
            fields = _TIME.fullmatch(written)
            if fields is None:
                raise CompactRefused("a unit with a malformed time")
            try:
                year, month, day, hour, minute, second = map(int, fields.groups())
                return datetime(year, month, day, hour, minute, second)  # noqa: DTZ001 - XML-RPC's have none
            except ValueError as error:
                raise CompactRefused("a unit with a malformed time") from error
        depth = _inside(depth)
        found: dict[str, object] = {}
        previous = b""
        for _ in range(self.head(MAP)):
            name, previous = self._next_name(depth, previous)
            (found[name],) = self.items(1, depth)
        return found

    def _next_name(self, depth: int, previous: bytes) -> tuple[str, bytes]:
        self._items_left -= 1
        begin = self.at
        name = self._text(depth)
        written = self._data[begin : self.at]
        if written <= previous:
            raise CompactRefused("a unit with the members of a struct out of order")
        return name, written

    def _refuse(self, _depth: int) -> object:
        raise CompactRefused("a unit with a tag")

    def _simple(self, _depth: int) -> object:
        first = self._data[self.at : self.at + 1]
        self.at += 1
        if first == DOUBLE:
            written = self._take(8)
            value: float = struct.unpack(">d", written)[0]
            if value != value and DOUBLE + written != NAN:  # noqa: PLR0124 - NaN alone differs
                raise CompactRefused("a unit with a NaN that says more than that")
            return value
        if first not in _TRUTH:
            raise CompactRefused("a unit with a value that XML-RPC does not have")
        return _TRUTH[first]


# Its own table, by the type in the three highest bits; called with the depth that is left.
_READERS: Final[tuple[Callable[[CompactReader, int], object], ...]] = (
    lambda reader, _: _int32(reader.head(UINT)),
    lambda reader, _: ~_int32(reader.head(NEGATIVE)),
    lambda reader, _: reader._take(reader.head(BYTES)),  # noqa: SLF001
    CompactReader._text,  # noqa: SLF001
    lambda reader, depth: reader.items(reader.head(ARRAY), _inside(depth)),
    CompactReader._map,  # noqa: SLF001
    CompactReader._refuse,  # noqa: SLF001
    CompactReader._simple,  # noqa: SLF001
)


def _int32(value: int) -> int:
    if value > _INT_MAX:
        raise CompactRefused("a unit with an integer beyond 32 bits")
    return value


def _check_text(text: str) -> None:
    if UNCARRIED.search(text) is not None:
        raise CompactRefused("a unit with a character that XML-RPC cannot carry")


def _inside(depth: int) -> int:
    if depth == 0:
        raise CompactRefused(f"a unit with values nested deeper than {DEPTH_LIMIT}")
    return depth - 1
