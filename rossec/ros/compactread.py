"""The strict reader of the compact form's values (docs/spec/compact.md). Pure.

One pass: a head that is not the shortest, a tag, an indefinite length, a member out of its order,
a text that is not UTF-8 is refused where it stands, so what is read has one encoding and was sent
in it. Only types of XML-RPC are built. It is read by hand, not by `cbor2`, which reads more than is
allowed here: its values would have to be walked, encoded again and compared
(docs/decisions/0045-compact-calls.md has the figures).
"""

import re
import struct
from collections.abc import Callable, Generator
from datetime import datetime
from typing import Final

from rossec.errors import CompactRefused
from rossec.ros.compactwrite import (
    ARRAY,
    BYTES,
    DEPTH_LIMIT,
    DOUBLE,
    ITEM_BYTES,
    MAP,
    NAN,
    NEGATIVE,
    TEXT,
    TIME_HEAD,
    UNCARRIED,
)

_WIDTHS: Final = {24: (1, 24), 25: (2, 1 << 8), 26: (4, 1 << 16)}  # bytes, and least value
_INT_MAX: Final = 2**31 - 1
_TIME_SIZE: Final = 17
_TIME: Final = re.compile(rb"(\d{4})(\d\d)(\d\d)T(\d\d):(\d\d):(\d\d)")
MALFORMED: Final = (IndexError, UnicodeDecodeError)
_TYPE: Final = 0xE0
STEP: Final = 1024  # values that are read at a time: about 1 ms


class _Open:
    """An array or a map that is being read: how many values are left, and what takes them."""

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


class Reader:
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
        """Whether all was read."""
        return self.at == len(self._data)

    def items(self, count: int, depth: int = DEPTH_LIMIT) -> list[object]:
        """The next `count` values, which may be nested `depth` levels deep."""
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
        """As `items`, in steps: it yields after `STEP` values."""
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
        """Read one value of `top`; of an array or a map only the head, which is returned."""
        if top.found is not None:
            top.name, top.previous = self._next_name(top.depth, top.previous)
            self._count(1)
        data, at = self._data, self.at
        major = data[at] & _TYPE
        if major == ARRAY:
            inner = _Open(self._count(self.head(ARRAY)), _deeper(top.depth))
            top.put(inner.values)
            return inner
        if major == MAP and not data.startswith(TIME_HEAD, at):
            inner = _Open(self.head(MAP), _deeper(top.depth), named=True)
            top.put(inner.found)
            return inner
        top.put(_READERS[major >> 5](self, top.depth))
        return None

    def _count(self, count: int) -> int:
        """Count values against the limit, before any is read."""
        self._items_left -= count
        if self._items_left < 0:
            raise CompactRefused("a unit with too many values")
        return count

    def skip(self, item: bytes) -> bool:
        """Whether the next item is this one of a byte; then it is read."""
        found = self._data.startswith(item, self.at)
        self.at += found
        return found

    def head(self, major: int) -> int:
        """The number in the next head, which must be of this type."""
        value = self._data[self.at] ^ major
        self.at += 1
        return value if value < 24 else self._long(value)

    def _long(self, info: int) -> int:
        width, least = _WIDTHS.get(info, (0, 0))
        if not width:
            raise CompactRefused("a unit with an item of another type or size")
        value = int.from_bytes(self._take(width))
        if value < least:
            raise CompactRefused("a unit whose numbers are not in their shortest form")
        return value

    def _take(self, size: int) -> bytes:
        begin = self.at
        self.at = end = begin + size
        if end > len(self._data):
            raise CompactRefused("a unit that ends too early")
        return self._data[begin:end]

    def _uint(self, _depth: int) -> int:
        return _int32(self.head(0))

    def _negative(self, _depth: int) -> int:
        return ~_int32(self.head(NEGATIVE))

    def _bytes(self, _depth: int) -> bytes:
        return self._take(self.head(BYTES))

    def _text(self, _depth: int) -> str:
        text = str(self._take(self.head(TEXT)), "utf-8")
        if not text.isprintable():
            _check_text(text)
        return text

    def _array(self, depth: int) -> list[object]:
        return self.items(self.head(ARRAY), _deeper(depth))

    def _map(self, depth: int) -> object:
        if self._data.startswith(TIME_HEAD, self.at):
            self.at += len(TIME_HEAD)
            return _time(self._take(_TIME_SIZE))
        depth = _deeper(depth)
        found: dict[str, object] = {}
        previous = b""
        for _ in range(self.head(MAP)):
            name, previous = self._next_name(depth, previous)
            (found[name],) = self.items(1, depth)
        return found

    def _next_name(self, depth: int, previous: bytes) -> tuple[str, bytes]:
        """The name of a member, which counts as a value, and how it is written."""
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
            return self._double()
        if first not in _TRUTH:
            raise CompactRefused("a unit with a value that XML-RPC does not have")
        return _TRUTH[first]

    def _double(self) -> float:
        written = self._take(8)
        value: float = struct.unpack(">d", written)[0]
        if value != value and DOUBLE + written != NAN:  # noqa: PLR0124 - NaN alone differs
            raise CompactRefused("a unit with a NaN that says more than that")
        return value


_TRUTH: Final = {b"\xf4": False, b"\xf5": True}
_READERS: Final[tuple[Callable[[Reader, int], object], ...]] = (
    Reader._uint,  # noqa: SLF001 - its own table, by the type in the three highest bits
    Reader._negative,  # noqa: SLF001
    Reader._bytes,  # noqa: SLF001
    Reader._text,  # noqa: SLF001
    Reader._array,  # noqa: SLF001
    Reader._map,  # noqa: SLF001
    Reader._refuse,  # noqa: SLF001
    Reader._simple,  # noqa: SLF001
)


def _int32(value: int) -> int:
    if value > _INT_MAX:
        raise CompactRefused("a unit with an integer beyond 32 bits")
    return value


def _check_text(text: str) -> None:
    if UNCARRIED.search(text) is not None:
        raise CompactRefused("a unit with a character that XML-RPC cannot carry")


def _time(written: bytes) -> datetime:
    """By hand: `strptime` takes ten times as long, and a unit has room for 50,000 of them."""
    fields = _TIME.fullmatch(written)
    if fields is None:
        raise CompactRefused("a unit with a malformed time")
    try:
        year, month, day, hour, minute, second = map(int, fields.groups())
        return datetime(year, month, day, hour, minute, second)  # noqa: DTZ001 - XML-RPC's have none
    except ValueError as error:
        raise CompactRefused("a unit with a malformed time") from error


def _deeper(depth: int) -> int:
    if depth == 0:
        raise CompactRefused(f"a unit with values nested deeper than {DEPTH_LIMIT}")
    return depth - 1
