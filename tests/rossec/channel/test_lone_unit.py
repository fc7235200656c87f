"""The way of a lone record (`lone_unit`, memory that connections share) against the way of all frames.

Both get the same reads of the same streams: cut anywhere, merged, replayed, reordered, damaged, renewed,
too long. Events, bytes to send, errors and what is left must be the same.
"""

import random  # noqa: TID251 - seeded, for reproducible failures
from collections.abc import Iterator
from typing import Any, Final

from rossec.channel.connection import Connection
from rossec.channel.negotiation import ConnectionState, Event, UnitReceived
from rossec.channel.records import HEADER, MAX_PLAINTEXT, ChannelLimits, Direction, Epochs, Frame, header
from rossec.channel.session import Session, UnitAssembly
from rossec.errors import ChannelError
from rossec.peer_limits import Progress
from tests.support.wire import NOW, FakeIdentity, alice, bob, joined, receive, renews

STREAMS: Final = 100_000
REFUSALS: Final = (
    "does not verify",
    "of another epoch",
    "of a forbidden length",
    "a unit of more than",
    "its keys for too long",
    "frame of type",
    "in the middle of a message",
)
SENT: Final = 1000  # before they are cut and damaged
LIMITS: Final = ChannelLimits(records=8, octets=1 << 14, seconds=100, unit=2000)
SHARED: Final = memoryview(bytearray(64 * 1024))
JUNK: Final = bytes(64 * 1024)

Core = Connection[FakeIdentity]
Result = tuple[list[Event[FakeIdentity]], bytes, str, ConnectionState, object]


def lean(core: Core, data: bytes) -> list[Event[FakeIdentity]]:
    """One read, as the shells do it; then other connections read into the memory."""
    room = core.get_buffer(SHARED)
    room[: len(data)] = data
    unit = core.lone_unit(len(data))
    events: list[Event[FakeIdentity]] = (
        core.buffer_updated(len(data), NOW) if unit is None else [UnitReceived(unit)]
    )
    SHARED[: len(data)] = JUNK[: len(data)]
    return events


def twin(of: Any) -> Any:
    """As `copy.copy`, which takes longer than all the rest of a stream."""
    made = object.__new__(type(of))
    for name in getattr(of, "__slots__", None) or vars(of):
        if name != "__weakref__" and hasattr(of, name):
            setattr(made, name, getattr(of, name))
    return made


def both_directions(epochs: Epochs) -> Epochs:
    copied: Epochs = twin(epochs)
    copied.sender, copied.receiver = twin(epochs.sender), twin(epochs.receiver)
    return copied


class Copies:
    """Ends of one connection as they were after its handshake: a handshake for each would take minutes."""

    def __init__(self) -> None:
        w = joined(left=alice(renews=renews), right=bob(limits=LIMITS, renews=renews))
        self._right = w.right.core
        assert w.left.core._session is not None
        assert self._right._session is not None
        self._session = self._right._session
        self._sender = w.left.core._session._epochs
        assert self._sender.sender.epoch == self._session.receive_epoch  # both are derived, once

    def receiver(self) -> Core:
        core: Core = twin(self._right)
        core._session = session = twin(self._session)
        session._epochs = both_directions(session._epochs)
        session._unit, session._progress = UnitAssembly(LIMITS.unit), Progress()
        core._buffer, core._renewals = twin(core._buffer), twin(core._renewals)
        core._out, core._events = [], []
        return core

    def records(self, dice: random.Random) -> Iterator[bytes]:
        epochs = both_directions(self._sender)
        for _ in range(dice.choice((1, 2, 3, 4, 4, 20))):
            yield from some_records(epochs.sender, dice)
            if dice.random() < 0.02:
                yield bytes(epochs.sender.seal(Frame.REKEY, b""))
                epochs.sender, epochs._waiting = epochs._advance()
        if dice.random() < 0.1:
            yield bytes(epochs.sender.seal(Frame.CLOSE, b""))


def some_records(sender: Direction, dice: random.Random) -> Iterator[bytes]:
    size = dice.choice((1, 2, 60, 300, 300)) if dice.random() < 0.98 else dice.choice((0, 2000, 2001, 9000))
    kind = dice.choices((Frame.DATA_END, Frame.DATA, Frame.PADDED_END, Frame.GRANTS), (16, 2, 1, 1))[0]
    data = dice.randbytes(size)
    if kind is Frame.PADDED_END:
        data += b"\1\0\0" if dice.random() < 0.9 else b""
    yield bytes(sender.seal(kind, data))


def damaged(records: list[bytes], dice: random.Random) -> list[bytes]:
    where = dice.randrange(len(records))
    match dice.randrange(8):
        case 0:
            hit = bytearray(records[where])
            hit[dice.choice((0, 1, 2, 3, dice.randrange(len(hit))))] ^= 1 << dice.randrange(8)
            records[where] = bytes(hit)
        case 1:
            records.insert(dice.randrange(len(records) + 1), records[where])
        case 2:
            dice.shuffle(records)
        case 3:
            del records[where]
        case 4:
            records[where] = records[where][: dice.randrange(len(records[where]))]
        case 5:
            records.insert(where, header(Frame.DATA_END, 0, dice.choice((0, 16, MAX_PLAINTEXT + 17))))
        case 6:
            records[where] += dice.randbytes(dice.randrange(1, 2 * HEADER))
        case _:
            records.insert(where, dice.randbytes(dice.randrange(1, 60)))
    return records


def reads(records: list[bytes], dice: random.Random) -> list[bytes]:
    """Mostly record by record; or together, or cut anywhere."""
    match dice.randrange(4):
        case 0:
            whole = b"".join(records)
            cuts = sorted(dice.sample(range(len(whole) + 1), min(len(whole), dice.randrange(5))))
            return [whole[start:end] for start, end in zip([0, *cuts], [*cuts, len(whole)], strict=True)]
        case 1:
            half = len(records) // 2
            return [b"".join(records[:half]), *records[half:]]
        case _:
            return records


def state_of(core: Core) -> object:
    """What decides about later records, and what the connection remembers of these."""
    session: Session | None = core._session
    if session is None:
        return None
    both = (session._epochs.sender, session._epochs.receiver)
    left = bytes(core._buffer.unread())
    counted = [(each.epoch, each.records, each.octets) for each in both]
    return counted, session._unit.length, session.deadline, left, core.deadline()


def compare(plain: Core, other: Core, data: bytes) -> str:
    """One read for both, and its error."""
    ends: list[Result] = []
    for core, take in ((plain, lambda core, data: receive(core, data, NOW)), (other, lean)):
        events: list[Event[FakeIdentity]] = []
        error = ""
        try:
            events = take(core, data)
        except ChannelError as caught:
            error = repr(caught)
        ends.append((events, bytes(core.data_to_send()), error, core.state, state_of(core)))
    assert ends[0] == ends[1]
    return ends[0][2]


def eof(core: Core) -> str:
    try:
        core.receive_eof()
    except ChannelError as error:
        return repr(error)
    return ""


def test_both_ways_do_the_same() -> None:
    dice, copies, lone = random.Random(33), Copies(), 0
    seen: set[str] = set()
    sent = [list(copies.records(dice)) for _ in range(SENT)]
    for _ in range(STREAMS):
        records = dice.choice(sent).copy()
        if dice.random() < 0.5:
            records = damaged(records, dice)
        plain, other = copies.receiver(), copies.receiver()
        for read in reads(records, dice):
            rest = read
            while rest:
                # Buffers of other sizes would cut the reads otherwise: only how, not what, may differ.
                count = min(len(rest), len(plain.get_buffer()), len(other.get_buffer(SHARED)))
                error = compare(plain, other, rest[:count])
                seen.add(error)
                rest = rest[count:] if not error else b""
            if plain.state is ConnectionState.CLOSED:
                break
        lone += other._buffer.capacity == 0
        assert eof(plain) == eof(other)
    assert lone > STREAMS / 2  # else this would compare one way with itself
    assert all(any(part in error for error in seen) for part in REFUSALS), seen


def test_what_is_no_lone_record_changes_nothing() -> None:
    """Until it is opened, nothing is counted; what is short of a header is no error here."""
    copies = Copies()
    for data in (b"", b"\x40", b"\x40\0\0\x11", header(Frame.DATA, 0, 30) + bytes(30), bytes(50)):
        core = copies.receiver()
        before = state_of(core)
        core.get_buffer(SHARED)[: len(data)] = data
        assert core.lone_unit(len(data)) is None
        assert state_of(core) == before


def test_the_beginning_of_a_record_is_moved_out_of_the_shared_memory() -> None:
    core = Copies().receiver()
    assert lean(core, b"\x40\0") == []
    assert bytes(core._buffer.unread()) == b"\x40\0"
    assert core.get_buffer(SHARED).obj is not SHARED.obj


def test_before_the_handshake_is_done_memory_is_its_own() -> None:
    core = bob()
    assert core.get_buffer(SHARED).obj is not SHARED.obj


def test_nothing_is_opened_after_the_end() -> None:
    copies = Copies()
    (record,) = some_records(copies._sender.sender, random.Random(1))
    for end in (Core.close, Core.abandon):
        core = copies.receiver()
        core.get_buffer(SHARED)[: len(record)] = record
        end(core)
        assert core.lone_unit(len(record)) is None
        assert core.buffer_updated(len(record), NOW) == []
