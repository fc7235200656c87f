"""Units of the stream multiplexer between two relays, as bytes. Pure.

A unit is a deterministic CBOR array `[stream, verb, ...]` (docs/spec/overlay.md); what arrives at
once is a sequence of them (RFC 8742). They are read by hand, not by `cbor2`: a payload is a view of
what arrived and is never copied. Whatever has another form is refused, and the link with it.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import Final, NamedTuple, TypeAlias

from ca.encoding import head
from ca.errors import NameRefused
from ca.names import MAX_NAME, check_name
from rossec.channel.records import Bytes
from rossec.errors import StreamRefused

MASTER: Final = "master"
NODE: Final = "node"
SERVICE: Final = "service"
KINDS: Final = (MASTER, NODE, SERVICE)  # a kind's number is its place here

HEADROOM: Final = 16  # bytes: no head of a data unit is longer
MAX_DATA: Final = 64 * 1024 - HEADROOM  # payload of a unit; with its head it is one small record
MAX_SEQUENCE: Final = 128 * 1024  # what arrives at once: a burst of small units, or one of data
_MAX_STREAM: Final = (1 << 32) - 1

_UINT, _BYTES, _TEXT, _ARRAY = 0, 0x40, 0x60, 0x80
_WIDTHS: Final = {24: (1, 24), 25: (2, 1 << 8), 26: (4, 1 << 16)}  # bytes, and least value


class Target(NamedTuple):
    """What a stream leads to, at the site of the called relay, by the names used there."""

    kind: str
    name: str

    def __str__(self) -> str:
        return f"{self.kind} {self.name}"


class Verb(IntEnum):
    """What a unit is about."""

    OPEN = 0
    DATA = 1
    CREDIT = 2
    END = 3
    RESET = 4


_DATA: Final = int(Verb.DATA)
_LENGTHS: Final = (4, 3, 3, 2, 2)  # items of a unit, by its verb


@dataclass(frozen=True, slots=True)
class Open:
    """The caller opens a stream."""

    stream: int
    target: Target


@dataclass(slots=True)  # one for each unit: frozen ones take three times as long to make
class Data:
    """Bytes of a stream; a view of what arrived."""

    stream: int
    payload: memoryview


@dataclass(frozen=True, slots=True)
class Credit:
    """So many bytes more may be sent."""

    stream: int
    amount: int


@dataclass(frozen=True, slots=True)
class End:
    """The sender sends nothing more in this stream."""

    stream: int


@dataclass(frozen=True, slots=True)
class Reset:
    """The stream is refused, or broken off."""

    stream: int


Unit: TypeAlias = Open | Data | Credit | End | Reset


def open_unit(stream: int, target: Target) -> bytes:
    """`[stream, 0, kind, name]`."""
    name = target.name.encode()
    kind = KINDS.index(target.kind)
    return _begin(Verb.OPEN, stream) + head(_UINT, kind) + head(_TEXT, len(name)) + name


def data_head(stream: int, length: int) -> bytes:
    """What precedes `length` bytes of payload in `[stream, 1, payload]`."""
    return _begin(Verb.DATA, stream) + head(_BYTES, length)


def credit_unit(stream: int, amount: int) -> bytes:
    """`[stream, 2, amount]`."""
    return _begin(Verb.CREDIT, stream) + head(_UINT, amount)


def end_unit(stream: int) -> bytes:
    """`[stream, 3]`."""
    return _begin(Verb.END, stream)


def reset_unit(stream: int) -> bytes:
    """`[stream, 4]`."""
    return _begin(Verb.RESET, stream)


def _begin(verb: Verb, stream: int) -> bytes:
    return head(_ARRAY, _LENGTHS[verb]) + head(_UINT, stream) + head(_UINT, verb)


def read_units(data: Bytes) -> list[Unit]:
    """The units in `data`, which is a whole sequence of them.

    Raises:
        StreamRefused: it is not, or one is out of its bounds.
    """
    if len(data) > MAX_SEQUENCE:
        raise StreamRefused(f"{len(data)} bytes of units where at most {MAX_SEQUENCE} are allowed")
    reader = _Reader(memoryview(data))
    units: list[Unit] = []
    while not reader.at_end:
        units.append(_read_unit(reader))
    return units


def _read_unit(reader: "_Reader") -> Unit:
    length = reader.head(_ARRAY, 4)
    stream = reader.head(_UINT, _MAX_STREAM)
    verb = reader.head(_UINT, 4)
    if length != _LENGTHS[verb]:
        raise StreamRefused(f"a unit of {length} items with the verb {verb}")
    if verb == _DATA:  # the usual one first
        return Data(stream, reader.take(reader.head(_BYTES, MAX_DATA, 1)))
    match Verb(verb):
        case Verb.CREDIT:
            return Credit(stream, reader.head(_UINT, _MAX_STREAM, 1))
        case Verb.OPEN:
            return Open(stream, _read_target(reader))
        case Verb.END:
            return End(stream)
        case _:
            return Reset(stream)


def _read_target(reader: "_Reader") -> Target:
    kind = KINDS[reader.head(_UINT, len(KINDS) - 1)]
    raw = bytes(reader.take(reader.head(_TEXT, MAX_NAME)))
    try:
        return Target(kind, check_name(raw.decode("ascii")))
    except (UnicodeDecodeError, NameRefused) as error:
        raise StreamRefused(f"a stream to {raw!r}, which is not a name") from error


class _Reader:
    """Heads of deterministic CBOR, one after the other."""

    __slots__ = ("_at", "_data", "_size")

    def __init__(self, data: memoryview) -> None:
        self._data = data
        self._size = len(data)
        self._at = 0

    @property
    def at_end(self) -> bool:
        return self._at == self._size

    def take(self, length: int) -> memoryview:
        begin = self._at
        end = begin + length
        if end > self._size:
            raise StreamRefused("a unit that ends too early")
        self._at = end
        return self._data[begin:end]

    def head(self, major: int, most: int, least: int = 0) -> int:
        """The number of a head of this type, from `least` to `most`, in its shortest form."""
        if self._at >= self._size:
            raise StreamRefused("a unit that ends too early")
        value = self._data[self._at] ^ major
        self._at += 1
        if value >= 24:
            value = self._long(value)
        if not least <= value <= most:
            raise StreamRefused(f"a unit with {value} where {least} to {most} are allowed")
        return value

    def _long(self, info: int) -> int:
        width, least = _WIDTHS.get(info, (0, 0))
        if not width:
            raise StreamRefused("a unit with an item of another type or size")
        value = int.from_bytes(self.take(width))
        if value < least:
            raise StreamRefused("a unit whose numbers are not in their shortest form")
        return value
