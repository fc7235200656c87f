"""The streams of one link between two relays: numbers, credit, limits, and their units as bytes. Pure.

What a relay may not do ends the link; what it may do too often is refused for that stream. A unit is a
deterministic CBOR array `[stream, verb, ...]`; what arrives at once is a sequence of them (RFC 8742).
Specification: docs/spec/overlay.md section 5.
"""

from collections import Counter
from dataclasses import dataclass
from enum import Enum, IntEnum, auto
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
_LENGTHS: Final = (4, 3, 3, 2, 2)  # items of a unit, by its verb
FIRST: Final = 256 * 1024  # bytes
MOST: Final = 4 * 1024 * 1024  # the window of a link
BUDGET: Final = 32 * 1024 * 1024
SHORTEST_ROUND: Final = 0.005  # seconds: two relays and two programs take turns
STREAMS: Final = 256
FOR_ONE_NAME: Final = STREAMS // 2
YOUNG: Final = 32
YOUNG_SECONDS: Final = 15.0
# The caller counts longer: what it opened last may reach the other side after a router's failure.
_CALLER_YOUNG_SECONDS: Final = YOUNG_SECONDS + 5.0
_ANSWERS: Final = 2  # of a target: the second one follows message_3, which authenticates the caller
LAST_STREAM: Final = (1 << 32) - 1


class StreamTarget(NamedTuple):
    kind: str
    name: str

    def __str__(self) -> str:
        return f"{self.kind} {self.name}"


class Verb(IntEnum):
    OPEN = 0
    DATA = 1
    CREDIT = 2
    END = 3
    RESET = 4


_DATA: Final = int(Verb.DATA)


class Open(NamedTuple):
    stream: int
    target: StreamTarget


@dataclass(slots=True)  # one for each unit: a frozen one takes three times as long to make
class Data:
    stream: int
    payload: memoryview  # of what arrived


class Credit(NamedTuple):
    stream: int
    amount: int


class End(NamedTuple):
    stream: int


class Reset(NamedTuple):
    stream: int


Unit: TypeAlias = Open | Data | Credit | End | Reset


def open_unit(stream: int, target: StreamTarget) -> bytes:
    name = target.name.encode()
    kind = KINDS.index(target.kind)
    return _begin(Verb.OPEN, stream) + head(_UINT, kind) + head(_TEXT, len(name)) + name


def data_head(stream: int, length: int) -> bytes:
    """What precedes `length` bytes of payload in `[stream, 1, payload]`."""
    return _begin(Verb.DATA, stream) + head(_BYTES, length)


def credit_unit(stream: int, amount: int) -> bytes:
    return _begin(Verb.CREDIT, stream) + head(_UINT, amount)


def end_unit(stream: int) -> bytes:
    return _begin(Verb.END, stream)


def reset_unit(stream: int) -> bytes:
    return _begin(Verb.RESET, stream)


def _begin(verb: Verb, stream: int) -> bytes:
    return head(_ARRAY, _LENGTHS[verb]) + head(_UINT, stream) + head(_UINT, verb)


def read_units(data: Bytes) -> list[Unit]:
    """The units in `data`, which is a whole sequence of them."""
    if len(data) > MAX_SEQUENCE:
        raise StreamRefused(f"{len(data)} bytes of units where at most {MAX_SEQUENCE} are allowed")
    reader = _Reader(memoryview(data))
    units: list[Unit] = []
    while reader.at < reader.size:
        length = reader.head(_ARRAY, 4)
        stream = reader.head(_UINT, _MAX_STREAM)
        verb = reader.head(_UINT, 4)
        if length != _LENGTHS[verb]:
            raise StreamRefused(f"a unit of {length} items with the verb {verb}")
        if verb == _DATA:  # the usual one first
            units.append(Data(stream, reader.take(reader.head(_BYTES, MAX_DATA, 1))))
        elif verb == Verb.CREDIT:
            units.append(Credit(stream, reader.head(_UINT, _MAX_STREAM, 1)))
        elif verb == Verb.OPEN:
            kind = KINDS[reader.head(_UINT, len(KINDS) - 1)]
            raw = bytes(reader.take(reader.head(_TEXT, MAX_NAME)))
            try:
                units.append(Open(stream, StreamTarget(kind, check_name(raw.decode("ascii")))))
            except (UnicodeDecodeError, NameRefused) as error:
                raise StreamRefused(f"a stream to {raw!r}, which is not a name") from error
        else:
            units.append(End(stream) if verb == Verb.END else Reset(stream))
    return units


class _Reader:
    # By hand, not by `cbor2`: a payload is a view of what arrived and is never copied.

    __slots__ = ("_data", "at", "size")

    def __init__(self, data: memoryview) -> None:
        self._data = data
        self.size = len(data)
        self.at = 0

    def take(self, length: int) -> memoryview:
        begin = self.at
        end = begin + length
        if end > self.size:
            raise StreamRefused("a unit that ends too early")
        self.at = end
        return self._data[begin:end]

    def head(self, major: int, most: int, least: int = 0) -> int:
        if self.at >= self.size:
            raise StreamRefused("a unit that ends too early")
        value = self._data[self.at] ^ major
        self.at += 1
        if value >= 24:
            width, shortest = _WIDTHS.get(value, (0, 0))
            if not width:
                raise StreamRefused("a unit with an item of another type or size")
            value = int.from_bytes(self.take(width))
            if value < shortest:
                raise StreamRefused("a unit whose numbers are not in their shortest form")
        if not least <= value <= most:
            raise StreamRefused(f"a unit with {value} where {least} to {most} are allowed")
        return value


class WindowBudget:
    """Bytes that the windows of one link may have beyond their first ones."""

    __slots__ = ("left",)

    def __init__(self, left: int = BUDGET) -> None:
        self.left = left


class ReceiveWindow:
    """One direction of a stream at its receiver; `allowed`: what the peer may still send.

    `allowed` and `held` (bytes that arrived and were not taken) are never more than `size`.
    """

    __slots__ = ("_began", "_budget", "_taken", "allowed", "held", "size")

    def __init__(self, budget: WindowBudget) -> None:
        self.size = self.allowed = FIRST
        self.held = 0
        self._budget = budget
        self._began = 0.0  # when the round began in which `_taken` bytes were taken
        self._taken = 0

    def arrived(self, length: int) -> None:
        self.allowed -= length
        self.held += length

    def took(self, count: int, now: float, round_trip_s: float) -> int:
        if count > self.held:
            raise ValueError("more was taken than arrived")
        self.held -= count
        self._taken += count
        # It grows while the program takes half of it in a round trip (TCP's "dynamic right-sizing"). That of
        # an idle way: the queue that a window makes must not widen it.
        round_s = max(round_trip_s, SHORTEST_ROUND)
        elapsed = now - self._began
        if round_trip_s > 0 and elapsed >= round_s:
            wanted = int(2 * self._taken * round_s / elapsed)
            self._began, self._taken = now, 0
            if self.held > self.size // 2:  # a program that lags gets no credit until it has shrunk
                self._resize(max(FIRST, self.size // 2, self.allowed + self.held))
            elif wanted > self.size and self.held == 0:
                self._resize(min(wanted, 2 * self.size, MOST, self.size + self._budget.left))
        credit = self.size - self.allowed - self.held
        if credit < self.size // 4:
            return 0
        self.allowed += credit
        return credit

    def _resize(self, size: int) -> None:
        self._budget.left -= size - self.size
        self.size = size

    def close(self) -> None:
        self._resize(FIRST)


class Role(Enum):
    CALLER = auto()
    CALLED = auto()


class StreamPhase(Enum):
    OPEN = auto()
    ENDED_HERE = auto()  # this side sends nothing more
    ENDED_THERE = auto()


class Side(Enum):
    HERE = auto()
    THERE = auto()


_AFTER_END: Final[dict[tuple[StreamPhase, Side], StreamPhase | None]] = {  # None: the stream is over
    (StreamPhase.OPEN, Side.HERE): StreamPhase.ENDED_HERE,
    (StreamPhase.OPEN, Side.THERE): StreamPhase.ENDED_THERE,
    (StreamPhase.ENDED_HERE, Side.THERE): None,
    (StreamPhase.ENDED_THERE, Side.HERE): None,
}


class StreamOpened(NamedTuple):
    stream: int
    target: StreamTarget


class OpeningRefused(NamedTuple):
    stream: int
    target: StreamTarget
    reply: bytes


Event: TypeAlias = StreamOpened | OpeningRefused | Data | Credit | End | Reset
"""`Credit`: the stream may send again; the others are the peer's."""


@dataclass(slots=True)
class _Stream:
    target: StreamTarget
    opened: float
    window: ReceiveWindow
    phase: StreamPhase = StreamPhase.OPEN
    may_send: int = FIRST
    asked: bool = False  # the caller spoke last
    answers: int = 0
    connecting: bool = False

    def spoke(self, *, to_target: bool) -> None:
        if self.asked and not to_target:
            self.answers += 1
        self.asked = to_target


class Mux:
    def __init__(self, role: Role, first: int = 0) -> None:
        self._streams: dict[int, _Stream] = {}
        self._for_name: Counter[StreamTarget] = Counter()
        self._budget = WindowBudget()
        self._abandoned: set[int] = set()  # over, and still being connected at the called side
        self._next = first
        self._caller = role is Role.CALLER
        self._young_seconds = _CALLER_YOUNG_SECONDS if self._caller else YOUNG_SECONDS

    def __len__(self) -> int:
        return len(self._streams)

    def __contains__(self, stream: int) -> bool:
        return stream in self._streams

    @property
    def used_up(self) -> bool:
        return self._next > LAST_STREAM

    # -- opening

    def crowded(self, target: StreamTarget, now: float) -> str:
        # "Limits": all, to one name, and those that are new, of which each makes the called side look.
        if len(self._streams) >= STREAMS:
            return f"{STREAMS} streams are open"
        if self._for_name[target] >= FOR_ONE_NAME:
            return f"{FOR_ONE_NAME} streams to it are open"
        young = len(self._abandoned)  # and those that are not in use yet
        for each in reversed(self._streams.values()):  # the newest first
            if each.opened <= now - self._young_seconds or young >= YOUNG:
                break
            young += each.answers < _ANSWERS
        return f"{YOUNG} streams are new" if young >= YOUNG else ""

    def connected(self, stream: int) -> None:
        # Until then one that is over counts as new: a peer that opens streams and breaks them off at once
        # would have any number of targets looked for (as CVE-2023-44487, of HTTP/2).
        self._abandoned.discard(stream)
        if stream in self._streams:
            self._streams[stream].connecting = False

    def open(self, target: StreamTarget, now: float) -> tuple[int, bytes]:
        reason = self.crowded(target, now) if self._caller else "only the caller opens streams"
        if reason or self.used_up:
            raise StreamRefused(f"no stream to {target}: {reason or 'the link is used up'}")
        return self._add(target, now), open_unit(self._next - 1, target)

    def _add(self, target: StreamTarget, now: float) -> int:
        number = self._next
        self._next += 1
        self._streams[number] = _Stream(target, now, ReceiveWindow(self._budget), connecting=not self._caller)
        self._for_name[target] += 1
        return number

    # -- sending

    def credit(self, stream: int) -> int:
        found = self._streams.get(stream)
        if found is None or found.phase is StreamPhase.ENDED_HERE:
            return 0
        return found.may_send

    def data(self, stream: int, length: int) -> bytes:
        if not 0 < length <= self.credit(stream):
            raise StreamRefused(f"{length} bytes beyond the credit of stream {stream}")
        found = self._streams[stream]
        found.may_send -= length
        found.spoke(to_target=self._caller)
        return data_head(stream, length)

    def took(self, stream: int, count: int, now: float = 0.0, round_trip_s: float = 0.0) -> bytes:
        found = self._streams.get(stream)
        if found is None or found.phase is StreamPhase.ENDED_THERE:
            return b""
        credit = found.window.took(count, now, round_trip_s)
        return credit_unit(stream, credit) if credit else b""

    def end(self, stream: int) -> bytes:
        found = self._streams.get(stream)
        if found is None or found.phase is StreamPhase.ENDED_HERE:
            return b""
        self._end(stream, found, Side.HERE)
        return end_unit(stream)

    def reset(self, stream: int) -> bytes:
        if stream not in self._streams:
            return b""
        self._remove(stream)
        return reset_unit(stream)

    # -- receiving

    def receive(self, data: Bytes, now: float) -> list[Event]:
        events = (
            self._opened(unit, now) if isinstance(unit, Open) else self._heard(unit)
            for unit in read_units(data)
        )
        return [event for event in events if event is not None]

    def _opened(self, unit: Open, now: float) -> Event:
        # "Numbers": only the relay that made the link opens, in this order, and no number is used again.
        if self._caller or unit.stream != self._next:
            raise StreamRefused(f"stream {unit.stream} is opened, which is not its turn")
        if self.crowded(unit.target, now):
            self._next += 1
            return OpeningRefused(unit.stream, unit.target, reset_unit(unit.stream))
        return StreamOpened(self._add(unit.target, now), unit.target)

    def _heard(self, unit: Data | Credit | End | Reset) -> Event | None:
        found = self._streams.get(unit.stream)
        if found is None:
            if unit.stream >= self._next:
                raise StreamRefused(f"a unit of stream {unit.stream}, which was never opened")
            return None  # on its way when the stream was broken off here
        match unit:
            case Data():
                length = len(unit.payload)
                if found.phase is StreamPhase.ENDED_THERE:
                    raise StreamRefused(f"bytes in stream {unit.stream} after its end")
                if length > found.window.allowed:
                    raise StreamRefused(f"{length} bytes in stream {unit.stream} beyond its credit")
                found.window.arrived(length)
                found.spoke(to_target=not self._caller)
            case Credit():
                if found.may_send + unit.amount > MOST:
                    raise StreamRefused(f"credit for stream {unit.stream} beyond {MOST} bytes")
                found.may_send += unit.amount
            case End():
                self._end(unit.stream, found, Side.THERE)
            case Reset():
                self._remove(unit.stream)
        return unit

    def _end(self, stream: int, found: _Stream, side: Side) -> None:
        if (found.phase, side) not in _AFTER_END:
            raise StreamRefused(f"a second end of stream {stream}")
        phase = _AFTER_END[found.phase, side]
        if phase is None:
            self._remove(stream)
        else:
            found.phase = phase

    def _remove(self, stream: int) -> None:
        found = self._streams.pop(stream)
        found.window.close()
        if found.connecting:
            self._abandoned.add(stream)
        self._for_name[found.target] -= 1
        if not self._for_name[found.target]:
            del self._for_name[found.target]
