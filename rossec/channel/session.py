"""The open half of a connection: units to records and back, the memory for both, and when keys are renewed.

A direction renews its keys after so many records, bytes or seconds, and stops hard at twice that. The two
directions are never more than one epoch apart: the receiver of REKEY follows at once, even if it has no data,
so that a one-way flow can be renewed again. Nothing of a unit is handed out before its last record has
verified. Memory grows by what has arrived, a unit's by what has verified: never by what a header announces.
"""

from collections.abc import Iterator, Sequence
from io import SEEK_END, BytesIO
from sys import getrefcount
from typing import Final

from rossec.channel.records import (
    HEADER,
    MAX_PLAINTEXT,
    TAG,
    Bytes,
    ChannelLimits,
    Direction,
    Epochs,
    Frame,
    fragments,
    header,
    padded,
    unpadded,
)
from rossec.channel.tuning import RECORDS_AT_ONCE, REUSE_BUFFER_ABOVE
from rossec.errors import ConnectionTruncated, LimitExceeded
from rossec.peer_limits import Progress

FIRST: Final = 256
"""For the opening of a caller and its message_1: what one that says nothing more costs."""
SMALL: Final = 2 * 1024
"""Before authentication, and no more until it is full; most messages of a handshake fit."""
OPEN: Final = 8 * 1024
"""After it: several small records fit."""
_GIVE_BACK: Final = 64 * 1024  # larger buffers are kept: allocating them again costs too much
_EARNED: Final = 8  # bytes of room for each that arrived: from 8 KiB to the largest size in 2 steps
_NOTHING: Final = bytearray()
_NO_VIEW: Final = memoryview(_NOTHING)
_NO_UNIT: Final = BytesIO()  # never written: most connections never have a unit of several records
_ITS_OWN: Final = 2  # references: the buffer's, and the argument of `getrefcount`
_KEEP: Final = 16 * 1024 * 1024  # memory of larger units is given back at once
_RECORD: Final = HEADER + MAX_PLAINTEXT + TAG
_SHORTEST: Final = HEADER + 1 + TAG


class ReceiveBuffer:
    """A byte queue whose free end is lent to the socket's reader; frames are decrypted from it in place.

    Bytes are moved only when an incomplete frame has reached the end of the buffer. It grows to twice the
    size when it is full, and for an authenticated peer at once to eight times the bytes that are there. An
    idle connection has none: an empty buffer is freed, but not one for large frames while many of them
    arrive.

    Where it has none, the reader may bring memory that all its connections share. What is left there of a
    read, the beginning of a frame, is moved to memory of its own (`keep`) before another one reads.
    """

    __slots__ = ("_data", "_end", "_least", "_start", "_view")

    def __init__(self, capacity: int = SMALL) -> None:
        self._least = capacity
        self._data = _NOTHING
        self._view = _NO_VIEW
        self._start = 0
        self._end = 0

    def __len__(self) -> int:
        return self._end - self._start

    @property
    def capacity(self) -> int:
        return len(self._data)

    def free(self, shared: memoryview | None = None) -> memoryview:
        # The free end, never empty; valid until the next call of any method.
        if self._data is _NOTHING:
            if shared is not None:
                self._view = shared
                return shared
            self._data = bytearray(self._least)
            self._view = memoryview(self._data)
        elif self._end == len(self._data):
            self._make_room(0 if self._start else 2 * len(self._data))
        return self._view[self._end :]

    def enlarge(self, size: int = OPEN) -> None:
        # Read more at a time from now on, by default because the peer is authenticated.
        self._least = size

    def filled(self, count: int) -> None:
        self._end += count

    def arrived(self, count: int) -> memoryview | None:
        # The `count` bytes just read, before they are `filled`; None: they continue others.
        return None if self._end else self._view[:count]

    def keep(self) -> None:
        if self._data is _NOTHING and self._end:
            self._make_room(max(self._least, len(self)))

    def unread(self) -> memoryview:
        return self._view[self._start : self._end]

    def consume(self, count: int) -> None:
        self._start += count
        if self._start < self._end:
            return
        self._start = self._end = 0
        if count <= self._least and len(self._data) <= _GIVE_BACK:
            self._data, self._view = _NOTHING, _NO_VIEW

    def expect(self, count: int, grow_to: int) -> None:
        if self._start + count <= len(self._data):
            return
        if count <= len(self._data):
            self._make_room(0)
            return
        wanted, earned = max(count, grow_to), _EARNED * len(self)
        self._make_room(max(self._least, wanted if earned >= wanted else min(earned, count - 1)))

    def clear(self) -> None:
        self._data, self._view = _NOTHING, _NO_VIEW
        self._start = self._end = 0

    def _make_room(self, size: int) -> None:
        unread, length = self.unread(), len(self)
        if size > len(self._data):
            self._data = bytearray(size)
            self._view = memoryview(self._data)
        self._view[:length] = unread
        self._start, self._end = 0, length


class UnitAssembly:
    """The unit being received, handed out only when its last record has verified.

    `BytesIO` because it gives a writable view to decrypt into, and then the very same memory as `bytes`,
    without a copy. Memory that the reader of a unit has released is reused: new pages cost about as much as
    decrypting into them.
    """

    __slots__ = ("_buffer", "_handed_out", "_last", "_room", "length", "limit")

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self._buffer = _NO_UNIT
        self._handed_out: tuple[BytesIO, ...] = ()  # the last two: the next unit comes before one is read
        self._room = 0
        self._last = 0  # size of the last unit: the next one is likely to be as large
        self.length = 0

    def add(self, direction: Direction, head: bytes, body: memoryview) -> None:
        end = self.check_room(len(body))
        if self.length == 0:
            self._buffer, self._room = BytesIO(), 0
            # Only whether it pays depends on the count: a `BytesIO` never writes into bytes that
            # are referenced elsewhere, it moves to a copy of its own first.
            if self._handed_out and getrefcount(self._handed_out[0].getvalue()) == _ITS_OWN:
                self._buffer, *rest = self._handed_out
                self._handed_out = tuple(rest)
                self._room = self._buffer.seek(0, SEEK_END)
        if end > self._room:
            self._grow(end)
        with self._buffer.getbuffer() as view, view[self.length : end] as target:
            direction.open_into(head, body, target)
        self.length = end

    def finish(self, direction: Direction, head: bytes, body: memoryview) -> bytes:
        if self.length == 0:
            self.check_room(len(body))
            return direction.open(head, body)
        self.add(direction, head, body)
        return self._finished()

    def finish_padded(self, direction: Direction, head: bytes, body: memoryview) -> bytes:
        self.check_room(len(body))
        last = unpadded(direction.open(head, body))
        if self.length == 0:
            return last
        end = self.length + len(last)
        if end > self._room:
            self._grow(end)
        with self._buffer.getbuffer() as view:
            view[self.length : end] = last
        self.length = end
        return self._finished()

    def _finished(self) -> bytes:
        self._buffer.truncate(self.length)
        unit = self._buffer.getvalue()
        if self.length <= _KEEP:
            self._handed_out = (*self._handed_out[-1:], self._buffer)
        self._last, self.length = self.length, 0
        return unit

    def discard(self) -> None:
        self._buffer, self._handed_out = _NO_UNIT, ()
        self._room = self.length = 0

    def check_room(self, body: int) -> int:
        end = self.length + body - TAG
        if end > self.limit:
            raise LimitExceeded(f"the peer sends a unit of more than {self.limit} bytes")
        return end

    def _grow(self, needed: int) -> None:
        self._room = min(self.limit, max(needed, 2 * self.length, self._last))
        self._buffer.seek(self._room - 1)
        self._buffer.write(b"\0")


class Session:
    __slots__ = ("_epochs", "_limits", "_progress", "_scratch", "_unit", "pad", "renew_at")

    def __init__(self, epochs: Epochs, limits: ChannelLimits, now: int) -> None:
        self._epochs = epochs
        self._limits = limits
        self._unit = UnitAssembly(limits.unit if limits.preauth_limit is None else limits.preauth_limit)
        self._progress = Progress()
        self._scratch: bytearray | None = None
        self.renew_at = now + limits.seconds
        self.pad = 0  # units are padded to a multiple of so many bytes

    @property
    def receive_epoch(self) -> int:  # of the peer's next record
        return self._epochs.receiver.epoch

    def ends_unit(self, head: bytes, size: int) -> bool:
        # Whether these are the header and the size of a record that does.
        if not _SHORTEST <= size <= _RECORD:
            return False
        return head == header(Frame.DATA_END, self._epochs.receiver.epoch, size - HEADER)

    @property
    def awaits_peer(self) -> bool:
        # Whether this direction was renewed, and the peer has not followed yet.
        return self._epochs.sender.epoch > self._epochs.receiver.epoch

    def raise_unit_limit(self, limit: int | None) -> None:
        # Accept units of up to `limit` from now on, never more than `ChannelLimits.unit`.
        most = self._limits.unit
        self._unit.limit = most if limit is None else min(limit, most)

    @property
    def deadline(self) -> int | None:
        return self._progress.deadline

    def check_progress(self, now: int, *, reading: bool) -> None:
        # Check that an incomplete unit grows; time counts only while this side is `reading`.
        if self._unit.length > 0:
            self._progress.check(now, self._unit.length, reading=reading)

    def check_unit(self, pieces: Sequence[Bytes]) -> None:
        # Refuse a unit that the peer would not take; nothing has happened to the connection.
        size, most = _size(pieces), self._limits.unit
        if size > most:
            raise LimitExceeded(
                f"a message of {size} bytes where at most {most} are allowed", "send it in parts"
            )

    def seal_small(self, unit: Bytes) -> Bytes | None:
        # Seal a unit of one record at once, unless a renewal is due.
        limits, sender = self._limits, self._epochs.sender
        if sender.records >= limits.records or sender.octets >= limits.octets:
            return None
        if self.pad:
            return sender.seal(*_padded(Frame.DATA_END, unit, self.pad))
        return sender.seal(Frame.DATA_END, unit)

    def seal_unit(self, pieces: Sequence[Bytes], *, reuse: bool) -> Iterator[Bytes]:
        # With `reuse` the records of a long unit share one buffer, several of them at a time.
        if not (reuse and _size(pieces) > REUSE_BUFFER_ABOVE):
            for kind, plaintext in self._kinds(pieces):
                if self._renewal_is_due():
                    yield self._rekey()
                yield self._epochs.sender.seal(kind, plaintext)
            return
        # One record behind the other; what lies there is yielded when the next does not fit.
        if self._scratch is None:
            self._scratch = bytearray(RECORDS_AT_ONCE * _RECORD)
        buffer, used = memoryview(self._scratch), 0
        for kind, plaintext in self._kinds(pieces):
            due = self._renewal_is_due()
            if used > 0 and (due or used + _RECORD > len(buffer)):
                yield buffer[:used]
                used = 0
            if due:
                yield self._rekey()
            record = self._epochs.sender.seal(kind, plaintext, buffer[used:])
            if isinstance(record, bytes):  # a small one is not sealed in place
                buffer[used : used + len(record)] = record
            used += len(record)
        yield buffer[:used]

    def _kinds(self, pieces: Sequence[Bytes]) -> Iterator[tuple[Frame, Bytes]]:
        # Of a padded unit all but the last are full: else their lengths were those of its pieces.
        held: Bytes | None = None
        pad = self.pad
        for plaintext in fragments((b"".join(pieces),) if pad else pieces):
            if held is not None:
                yield Frame.DATA, held
            held = plaintext
        if held is not None:
            last = (Frame.DATA_END, held)
            yield _padded(*last, pad) if pad else last

    def _renewal_is_due(self) -> bool:
        limits, sender = self._limits, self._epochs.sender
        if sender.records < limits.records and sender.octets < limits.octets:
            return False
        if not self.awaits_peer:
            return True
        if _beyond(sender, limits):
            raise LimitExceeded("the peer does not follow the renewal of the keys")
        return False

    def _rekey(self) -> Bytes:
        record = self._epochs.sender.seal(Frame.REKEY, b"")
        self._epochs.next_sender()
        return record

    def close_record(self) -> Bytes:
        return self._epochs.sender.seal(Frame.CLOSE, b"")

    def seal_renewal(self, kind: Frame, data: bytes) -> Bytes:
        return self._epochs.sender.seal(kind, data)

    def open_renewal(self, head: bytes, body: memoryview) -> bytes:
        # Take such a record; the unit that has begun is not touched.
        return self._receiver().open(head, body)

    def renew(self, now: int) -> Bytes:
        if now < self.renew_at:
            return b""
        self.renew_at = now + self._limits.seconds
        sender = self._epochs.sender
        if self.awaits_peer:
            raise LimitExceeded("the peer does not follow the renewal of the keys")
        return self._rekey() if sender.records > 0 else b""

    def check_room(self, length: int) -> None:
        self._unit.check_room(length)

    def discard(self) -> None:
        self._unit.discard()
        self._scratch = None

    def data(self, head: bytes, body: memoryview, now: int) -> None:
        # Take a record that does not end its unit.
        self._unit.add(self._receiver(), head, body)
        self._progress.check(now, self._unit.length)

    def data_end(self, head: bytes, body: memoryview) -> bytes:
        if self._unit.length > 0:
            self._progress.done()
        return self._unit.finish(self._receiver(), head, body)

    def padded_end(self, head: bytes, body: memoryview) -> bytes:
        if self._unit.length > 0:
            self._progress.done()
        return self._unit.finish_padded(self._receiver(), head, body)

    def _receiver(self) -> Direction:
        receiver = self._epochs.receiver
        if _beyond(receiver, self._limits):
            raise LimitExceeded("the peer uses its keys for too long")
        return receiver

    def rekey(self, head: bytes, body: memoryview) -> Bytes:
        self._epochs.receiver.open(head, body)
        self._epochs.next_receiver()
        behind = self._epochs.sender.epoch < self._epochs.receiver.epoch
        return self._rekey() if behind else b""

    def close(self, head: bytes, body: memoryview) -> None:
        self._epochs.receiver.open(head, body)
        if self._unit.length > 0:
            raise ConnectionTruncated("the peer closed the connection in the middle of a message")


def _padded(kind: Frame, plaintext: Bytes, multiple: int) -> tuple[Frame, Bytes]:
    longer = padded(plaintext, multiple)
    return (kind, plaintext) if longer is None else (Frame.PADDED_END, longer)


def _size(pieces: Sequence[Bytes]) -> int:
    return sum(p.nbytes if isinstance(p, memoryview) else len(p) for p in pieces)


def _beyond(direction: Direction, limits: ChannelLimits) -> bool:
    return direction.records >= 2 * limits.records or direction.octets >= 2 * limits.octets + MAX_PLAINTEXT
