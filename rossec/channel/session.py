"""The open half of a connection: units to records and back, and when keys are renewed.

A direction renews its keys after so many records, bytes or seconds, and stops hard at twice that.
The two directions are never more than one epoch apart: the receiver of REKEY follows at once, even
if it has no data, so that a one-way flow can be renewed again.
"""

from collections.abc import Iterator, Sequence
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
    padded,
)
from rossec.channel.unit_assembly import UnitAssembly
from rossec.errors import ConnectionTruncated, LimitExceeded
from rossec.progress import Progress

_REUSE_ABOVE: Final = 64 * 1024
_RECORD: Final = HEADER + MAX_PLAINTEXT + TAG
_JOINED: Final = 4  # whole records in the buffer; beyond a megabyte nothing is gained


class Session:
    """Both directions of an open connection; `now` is when it opened."""

    def __init__(self, epochs: Epochs, limits: ChannelLimits, now: int) -> None:
        self._epochs = epochs
        self._limits = limits
        self._unit = UnitAssembly(
            limits.unit if limits.preauth_limit is None else limits.preauth_limit
        )
        self._progress = Progress()
        self._scratch: bytearray | None = None
        self.renew_at = now + limits.seconds
        self.pad = 0  # units are padded to a multiple of so many bytes

    @property
    def receive_epoch(self) -> int:
        """The epoch the peer's next record must be of."""
        return self._epochs.receiver.epoch

    @property
    def awaits_peer(self) -> bool:
        """Whether this direction was renewed, and the peer has not followed yet."""
        return self._epochs.sender.epoch > self._epochs.receiver.epoch

    def raise_unit_limit(self, limit: int | None) -> None:
        """Accept units of up to `limit` from now on, never more than `ChannelLimits.unit`."""
        most = self._limits.unit
        self._unit.limit = most if limit is None else min(limit, most)

    @property
    def deadline(self) -> int | None:
        """When `check_progress` is due; None: no unit is incomplete."""
        return self._progress.deadline

    def check_progress(self, now: int, *, reading: bool) -> None:
        """Check that an incomplete unit grows; time counts only while this side is `reading`.

        Raises:
            LimitExceeded: it does not.
        """
        if self._unit.length > 0:
            self._progress.check(now, self._unit.length, reading=reading)

    def check_unit(self, pieces: Sequence[Bytes]) -> None:
        """Refuse a unit that the peer would not take; nothing has happened to the connection.

        Raises:
            LimitExceeded: longer than `ChannelLimits.unit`.
        """
        size = _size(pieces)
        if size > self._limits.unit:
            raise LimitExceeded(
                f"a message of {size} bytes where at most {self._limits.unit} are allowed",
                "send it in parts",
            )

    def seal_small(self, unit: Bytes) -> Bytes | None:
        """Seal a unit of one record at once, unless a renewal is due."""
        limits, sender = self._limits, self._epochs.sender
        if sender.records >= limits.records or sender.octets >= limits.octets:
            return None
        if self.pad:
            return sender.seal(*_padded(Frame.DATA_END, unit, self.pad))
        return sender.seal(Frame.DATA_END, unit)

    def seal_unit(self, pieces: Sequence[Bytes], *, reuse: bool) -> Iterator[Bytes]:
        """Yield the records of a unit, and REKEY records where they are due.

        With `reuse` large records share one buffer, several of them at a time: a new one for each
        costs a sixth of the encryption, for zeroing it, and a system call for each costs more.

        Raises:
            LimitExceeded: the peer did not follow a rekey in time.
        """
        if reuse and _size(pieces) > _REUSE_ABOVE:
            yield from self._joined(pieces, memoryview(self._shared_buffer()))
            return
        for kind, plaintext in self._kinds(pieces):
            if self._renewal_is_due():
                yield self._rekey()
            yield self._epochs.sender.seal(kind, plaintext)

    def _joined(self, pieces: Sequence[Bytes], buffer: memoryview) -> Iterator[Bytes]:
        """Seal one record behind the other; yield what lies there when the next does not fit."""
        used = 0
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
        """The plaintexts of a unit's records, the last one marked as such.

        Of a padded unit all but the last are full: else their lengths were those of its pieces.
        """
        held: Bytes | None = None
        pad = self.pad
        for plaintext in fragments((b"".join(pieces),) if pad else pieces):
            if held is not None:
                yield Frame.DATA, held
            held = plaintext
        if held is not None:
            last = (Frame.DATA_END, held)
            yield _padded(*last, pad) if pad else last

    def _shared_buffer(self) -> bytearray:
        if self._scratch is None:
            self._scratch = bytearray(_JOINED * _RECORD)
        return self._scratch

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
        """The authenticated end of this direction."""
        return self._epochs.sender.seal(Frame.CLOSE, b"")

    def seal_renewal(self, kind: Frame, data: bytes) -> Bytes:
        """A record that belongs to no unit, also in the middle of one."""
        return self._epochs.sender.seal(kind, data)

    def open_renewal(self, head: bytes, body: memoryview) -> bytes:
        """Take such a record; the unit that has begun is not touched."""
        return self._receiver().open(head, body)

    def renew(self, now: int) -> Bytes:
        """Renew this direction's keys if it is time and they were used; return what to send.

        Raises:
            LimitExceeded: the peer did not follow the last renewal for a whole period.
        """
        if now < self.renew_at:
            return b""
        self.renew_at = now + self._limits.seconds
        sender = self._epochs.sender
        if self.awaits_peer:
            raise LimitExceeded("the peer does not follow the renewal of the keys")
        return self._rekey() if sender.records > 0 else b""

    def check_room(self, length: int) -> None:
        """Refuse a record whose header says that its unit becomes too long, before it arrives.

        Raises:
            LimitExceeded: it does.
        """
        self._unit.check_room(length)

    def discard(self) -> None:
        """The connection has ended: drop the incomplete unit, whoever still refers to this."""
        self._unit.discard()
        self._scratch = None

    def data(self, head: bytes, body: memoryview, now: int) -> None:
        """Take a record that does not end its unit."""
        self._unit.add(self._receiver(), head, body)
        self._progress.check(now, self._unit.length)

    def data_end(self, head: bytes, body: memoryview) -> bytes:
        """Take the last record of a unit and return the unit."""
        if self._unit.length > 0:
            self._progress.done()
        return self._unit.finish(self._receiver(), head, body)

    def padded_end(self, head: bytes, body: memoryview) -> bytes:
        """Take the last record of a unit, a padded one, and return the unit."""
        if self._unit.length > 0:
            self._progress.done()
        return self._unit.finish_padded(self._receiver(), head, body)

    def _receiver(self) -> Direction:
        receiver = self._epochs.receiver
        if _beyond(receiver, self._limits):
            raise LimitExceeded("the peer uses its keys for too long")
        return receiver

    def rekey(self, head: bytes, body: memoryview) -> Bytes:
        """Take the peer's REKEY; return this side's own if it has to follow."""
        self._epochs.receiver.open(head, body)
        self._epochs.next_receiver()
        behind = self._epochs.sender.epoch < self._epochs.receiver.epoch
        return self._rekey() if behind else b""

    def close(self, head: bytes, body: memoryview) -> None:
        """Take the peer's CLOSE.

        Raises:
            ConnectionTruncated: it comes in the middle of a unit.
        """
        self._epochs.receiver.open(head, body)
        if self._unit.length > 0:
            raise ConnectionTruncated("the peer closed the connection in the middle of a message")


def _padded(kind: Frame, plaintext: Bytes, multiple: int) -> tuple[Frame, Bytes]:
    longer = padded(plaintext, multiple)
    return (kind, plaintext) if longer is None else (Frame.PADDED_END, longer)


def _size(pieces: Sequence[Bytes]) -> int:
    return sum(p.nbytes if isinstance(p, memoryview) else len(p) for p in pieces)


def _beyond(direction: Direction, limits: ChannelLimits) -> bool:
    return (
        direction.records >= 2 * limits.records
        or direction.octets >= 2 * limits.octets + MAX_PLAINTEXT
    )
