"""The streams of one link between two relays: numbers, credit, limits. Pure.

Only the relay that made the link opens streams; it numbers them 0, 1, 2, ... and no number is used
again. Each direction of a stream has its own credit, so that no stream fills the link's memory and
a slow one stops itself alone. What a relay may not do ends the link; what it may do too often is
refused for that stream. Specification: docs/spec/overlay.md.
"""

from collections import Counter
from dataclasses import dataclass
from enum import Enum, auto
from typing import Final, TypeAlias

from rossec.channel.records import Bytes
from rossec.errors import StreamRefused
from rossec.overlay.mux_units import (
    Credit,
    Data,
    End,
    Open,
    Reset,
    Target,
    Unit,
    credit_unit,
    data_head,
    end_unit,
    open_unit,
    read_units,
    reset_unit,
)
from rossec.overlay.stream_window import FIRST, MOST, Fund, ReceiveWindow

STREAMS: Final = 256
FOR_ONE_NAME: Final = STREAMS // 2
YOUNG: Final = 32
YOUNG_SECONDS: Final = 15.0
# The caller counts longer: what it opened last may reach the other side after a router's failure.
_CALLER_YOUNG_SECONDS: Final = YOUNG_SECONDS + 5.0
_ANSWERS: Final = 2  # of a target: the second one follows message_3, which authenticates the caller
LAST_STREAM: Final = (1 << 32) - 1


class Role(Enum):
    """Which side of the link this is."""

    CALLER = auto()
    CALLED = auto()


class Phase(Enum):
    """Which directions of a stream are open."""

    OPEN = auto()
    ENDED_HERE = auto()  # this side sends nothing more
    ENDED_THERE = auto()


class Side(Enum):
    """Who ends a direction."""

    HERE = auto()
    THERE = auto()


_AFTER_END: Final[dict[tuple[Phase, Side], Phase | None]] = {  # None: the stream is over
    (Phase.OPEN, Side.HERE): Phase.ENDED_HERE,
    (Phase.OPEN, Side.THERE): Phase.ENDED_THERE,
    (Phase.ENDED_HERE, Side.THERE): None,
    (Phase.ENDED_THERE, Side.HERE): None,
}


@dataclass(frozen=True, slots=True)
class Opened:
    """The caller opened a stream: connect it to its target."""

    stream: int
    target: Target


@dataclass(frozen=True, slots=True)
class Refused:
    """A stream of the caller was refused, as it has too many: send `reply`."""

    stream: int
    target: Target
    reply: bytes


Event: TypeAlias = Opened | Refused | Data | Credit | End | Reset
"""`Credit`: the stream may send again; the others are the peer's."""


@dataclass(slots=True)
class _Stream:
    target: Target
    opened: float
    window: ReceiveWindow
    phase: Phase = Phase.OPEN
    may_send: int = FIRST
    asked: bool = False  # the caller spoke last
    answers: int = 0
    connecting: bool = False

    def spoke(self, *, to_target: bool) -> None:
        """Count how often the target answered: see `_ANSWERS`."""
        if self.asked and not to_target:
            self.answers += 1
        self.asked = to_target


class Mux:
    """One side of the streams of a link; the next one opened has the number `first`."""

    def __init__(self, role: Role, first: int = 0) -> None:
        self._streams: dict[int, _Stream] = {}
        self._for_name: Counter[Target] = Counter()
        self._fund = Fund()
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
        """Whether the link has no more numbers for streams: make another."""
        return self._next > LAST_STREAM

    # -- opening

    def crowded(self, target: Target, now: float) -> str:
        """Why no stream to `target` may be opened now (seconds, monotonic); empty: one may."""
        if len(self._streams) >= STREAMS:
            return f"{STREAMS} streams are open"
        if self._for_name[target] >= FOR_ONE_NAME:
            return f"{FOR_ONE_NAME} streams to it are open"
        new = len(self._abandoned) + self._young_since(now - self._young_seconds)
        return f"{YOUNG} streams are new" if new >= YOUNG else ""

    def _young_since(self, since: float) -> int:
        """Streams that were opened after `since` and are not in use yet, up to `YOUNG`."""
        young = 0
        for each in reversed(self._streams.values()):  # the newest first
            if each.opened <= since or young >= YOUNG:
                break
            young += each.answers < _ANSWERS
        return young

    def connected(self, stream: int) -> None:
        """The called side is done with connecting the stream, whatever came of it.

        Until then one that is over counts as new: a peer that opens streams and breaks them off
        at once would have any number of targets looked for (as CVE-2023-44487, of HTTP/2).
        """
        self._abandoned.discard(stream)
        if stream in self._streams:
            self._streams[stream].connecting = False

    def open(self, target: Target, now: float) -> tuple[int, bytes]:
        """The number of a new stream, and the unit that opens it.

        Raises:
            StreamRefused: there is no room, or this side may open none.
        """
        reason = self.crowded(target, now) if self._caller else "only the caller opens streams"
        if reason or self.used_up:
            raise StreamRefused(f"no stream to {target}: {reason or 'the link is used up'}")
        return self._add(target, now), open_unit(self._next - 1, target)

    def _add(self, target: Target, now: float) -> int:
        number = self._next
        self._next += 1
        self._streams[number] = _Stream(
            target, now, ReceiveWindow(self._fund), connecting=not self._caller
        )
        self._for_name[target] += 1
        return number

    # -- sending

    def credit(self, stream: int) -> int:
        """How many bytes may be sent in the stream now; 0 too if it is over."""
        found = self._streams.get(stream)
        if found is None or found.phase is Phase.ENDED_HERE:
            return 0
        return found.may_send

    def data(self, stream: int, length: int) -> bytes:
        """The head of a unit with `length` bytes, which are sent after it; costs credit.

        Raises:
            StreamRefused: the stream is over, or has not that much credit: an error here.
        """
        if not 0 < length <= self.credit(stream):
            raise StreamRefused(f"{length} bytes beyond the credit of stream {stream}")
        found = self._streams[stream]
        found.may_send -= length
        found.spoke(to_target=self._caller)
        return data_head(stream, length)

    def took(self, stream: int, count: int, now: float = 0.0, round_trip_s: float = 0.0) -> bytes:
        """The program took `count` received bytes; the unit that gives credit, if it is time.

        Args:
            round_trip_s: of the link when it is idle; 0 (windows stay as they are) if not known.
        """
        found = self._streams.get(stream)
        if found is None or found.phase is Phase.ENDED_THERE:
            return b""
        credit = found.window.took(count, now, round_trip_s)
        return credit_unit(stream, credit) if credit else b""

    def end(self, stream: int) -> bytes:
        """The unit that ends this direction; empty if it has ended."""
        found = self._streams.get(stream)
        if found is None or found.phase is Phase.ENDED_HERE:
            return b""
        self._end(stream, found, Side.HERE)
        return end_unit(stream)

    def reset(self, stream: int) -> bytes:
        """The unit that breaks the stream off; empty if it is over."""
        if stream not in self._streams:
            return b""
        self._remove(stream)
        return reset_unit(stream)

    # -- receiving

    def receive(self, data: Bytes, now: float) -> list[Event]:
        """What the units in `data` mean, in order.

        Raises:
            StreamRefused: they are malformed, or nothing that the peer may send: end the link.
        """
        events = []
        for unit in read_units(data):
            event = self._receive(unit, now)
            if event is not None:
                events.append(event)
        return events

    def _receive(self, unit: Unit, now: float) -> Event | None:
        if isinstance(unit, Open):
            return self._opened(unit, now)
        found = self._streams.get(unit.stream)
        if found is None:
            if unit.stream >= self._next:
                raise StreamRefused(f"a unit of stream {unit.stream}, which was never opened")
            return None  # on its way when the stream was broken off here
        match unit:
            case Data():
                self._arrived(found, unit)
            case Credit():
                self._credited(found, unit)
            case End():
                self._end(unit.stream, found, Side.THERE)
            case Reset():
                self._remove(unit.stream)
        return unit

    def _opened(self, unit: Open, now: float) -> Event:
        if self._caller or unit.stream != self._next:
            raise StreamRefused(f"stream {unit.stream} is opened, which is not its turn")
        if self.crowded(unit.target, now):
            self._next += 1
            return Refused(unit.stream, unit.target, reset_unit(unit.stream))
        return Opened(self._add(unit.target, now), unit.target)

    def _arrived(self, found: _Stream, unit: Data) -> None:
        length = len(unit.payload)
        if found.phase is Phase.ENDED_THERE:
            raise StreamRefused(f"bytes in stream {unit.stream} after its end")
        if length > found.window.allowed:
            raise StreamRefused(f"{length} bytes in stream {unit.stream} beyond its credit")
        found.window.arrived(length)
        found.spoke(to_target=not self._caller)

    def _credited(self, found: _Stream, unit: Credit) -> None:
        if found.may_send + unit.amount > MOST:
            raise StreamRefused(f"credit for stream {unit.stream} beyond {MOST} bytes")
        found.may_send += unit.amount

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
        target = found.target
        self._for_name[target] -= 1
        if not self._for_name[target]:
            del self._for_name[target]
