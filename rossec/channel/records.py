"""Frames, and the records of an open connection: AEAD with counters that are never sent.

A frame is a 4-byte header, big endian: type (4 bits), epoch mod 16 (4 bits), length of the body (24 bits). A
record is a frame whose body is sealed; its header is the associated data, its nonce is IV xor a 64-bit
counter, one counter per direction and epoch. TCP delivers in order, so there is no window: whatever is
replayed, reordered or left out fails the tag. When to send which record is decided by the connection.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Final, TypeAlias

from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.ciphers.aead import AESGCM, ChaCha20Poly1305

from rossec.channel.edhoc.messages import MAX_MESSAGE
from rossec.channel.edhoc.suites import EdhocExporter, Suite
from rossec.channel.tuning import ENCRYPT_INTO_FROM, JOIN_PIECES_BELOW
from rossec.errors import ChannelError, LimitExceeded, ProtocolViolation

HEADER: Final = 4
TAG: Final = 16
MAX_PLAINTEXT: Final = 256 * 1024  # the measured optimum, and the bound on what waits for its tag
MAX_GRANTS: Final = 40 * 1024
_INITIATOR_SENDS: Final = 32768  # exporter labels for private use, key and IV each
_RESPONDER_SENDS: Final = 32770
_RECORD_AEADS: Final = (AESGCM, ChaCha20Poly1305)

Bytes: TypeAlias = bytes | bytearray | memoryview


class Frame(IntEnum):
    HANDSHAKE = 1
    ERROR = 2
    DATA = 3  # more of this unit follows
    DATA_END = 4  # the last of a unit
    REKEY = 5  # the last record of this direction's epoch
    CLOSE = 6  # the last record of this direction
    IDENTITY = 7  # this side's certificate was renewed
    GRANTS = 8  # grants that take the place of those presented before
    PADDED_END = 9  # the last of a unit, with padding behind its data


# Empty data records would be work without progress.
_LENGTHS: Final[dict[int, tuple[int, int]]] = {
    Frame.HANDSHAKE: (1, MAX_MESSAGE),
    Frame.ERROR: (1, 1024),
    Frame.DATA: (TAG + 1, TAG + MAX_PLAINTEXT),
    Frame.DATA_END: (TAG + 1, TAG + MAX_PLAINTEXT),
    Frame.REKEY: (TAG, TAG),
    Frame.CLOSE: (TAG, TAG),
    Frame.IDENTITY: (TAG + 1, TAG + MAX_MESSAGE),
    Frame.GRANTS: (TAG + 1, TAG + MAX_GRANTS),
    Frame.PADDED_END: (TAG + 2, TAG + MAX_PLAINTEXT),
}


@dataclass(frozen=True)
class ChannelLimits:
    """Where the channel stops or renews its keys; the defaults are the notes' (AEAD limits). `preauth_limit`:
    how long a unit may be before the peer is authorized; None: as `unit`."""

    records: int = 1 << 23
    octets: int = 1 << 36
    seconds: int = 3600
    unit: int = 256 * 1024 * 1024
    preauth_limit: int | None = None
    handshake_seconds: int = 5


def frame(kind: Frame, body: bytes, epoch: int = 0) -> bytes:
    return header(kind, epoch, len(body)) + body


def header(kind: Frame, epoch: int, length: int) -> bytes:
    return (kind << 28 | (epoch & 15) << 24 | length).to_bytes(4)


def check_header(head: bytes, epoch: int) -> int:
    word = int.from_bytes(head)
    shortest, longest = _LENGTHS[word >> 28]
    if word >> 24 & 15 != epoch & 15:
        raise ProtocolViolation("a frame of another epoch")
    length = word & 0xFFFFFF
    if not shortest <= length <= longest:
        raise ProtocolViolation("a frame of a forbidden length")
    return length


class Direction:
    __slots__ = ("_aead", "_iv", "epoch", "octets", "records")

    def __init__(self, suite: Suite, exporter: EdhocExporter, label: int, epoch: int) -> None:
        # The version and the epoch are the context; the role is in the label.
        context = b"rossec/1" + epoch.to_bytes(8)
        aead = suite.aead(exporter.export(label, context, suite.key_length))
        if not isinstance(aead, _RECORD_AEADS):
            raise ProtocolViolation("this cipher suite has no record layer")
        self._aead = aead
        self._iv = int.from_bytes(exporter.export(label + 1, context, suite.nonce_length))
        self.epoch = epoch
        self.records = 0  # the counter: consumed before use, so a failure never reuses it
        self.octets = 0

    def _nonce(self, length: int) -> bytes:
        counter = self.records
        if counter >= 1 << 48:  # far above any limit; a nonce must not repeat, whatever happens
            raise LimitExceeded("the record counter is used up")
        self.records = counter + 1
        self.octets += length
        return (self._iv ^ counter).to_bytes(12)

    def seal(self, kind: Frame, plaintext: Bytes, scratch: bytearray | memoryview | None = None) -> Bytes:
        length = len(plaintext)
        head = (kind << 28 | (self.epoch & 15) << 24 | (length + TAG)).to_bytes(4)
        nonce = self._nonce(length)
        if length < ENCRYPT_INTO_FROM:
            return head + self._aead.encrypt(nonce, plaintext, head)
        if scratch is None:
            scratch = bytearray(HEADER + length + TAG)
        record = memoryview(scratch)[: HEADER + length + TAG]
        record[:HEADER] = head
        self._aead.encrypt_into(nonce, plaintext, head, record[HEADER:])
        return record

    def open(self, head: bytes, body: memoryview) -> bytes:
        try:
            return self._aead.decrypt(self._nonce(len(body) - TAG), body, head)
        except InvalidTag:
            raise ChannelError("a record does not verify") from None

    def open_into(self, head: bytes, body: memoryview, target: memoryview) -> None:
        # Decrypt into `target`, whose content counts only if this returns.
        try:
            self._aead.decrypt_into(self._nonce(len(body) - TAG), body, head, target)
        except InvalidTag:
            raise ChannelError("a record does not verify") from None


class Epochs:
    """The keys of both directions, epoch after epoch (EDHOC_KeyUpdate).

    When the first direction moves on, the keys of *both* for the new epoch are derived and PRK_out
    of the old one is dropped at once: a silent direction keeps only its own traffic key alive.
    """

    __slots__ = ("_exporter", "_labels", "_suite", "_waiting", "receiver", "sender")
    sender: Direction
    receiver: Direction

    def __init__(self, suite: Suite, exporter: EdhocExporter, *, initiator: bool) -> None:
        labels = (_INITIATOR_SENDS, _RESPONDER_SENDS)
        self._labels = labels if initiator else labels[::-1]
        self._suite = suite
        self._exporter = exporter
        self._waiting: Direction | None = None

    def __getattr__(self, name: str) -> Direction:
        if name not in {"sender", "receiver"}:
            raise AttributeError(name)
        self.sender, self.receiver = self._derive(0)
        return self.sender if name == "sender" else self.receiver

    def _derive(self, epoch: int) -> tuple[Direction, Direction]:
        own, peer = self._labels
        exporter, self._exporter = self._exporter, self._exporter.bare()
        return (Direction(self._suite, exporter, own, epoch), Direction(self._suite, exporter, peer, epoch))

    def _advance(self) -> tuple[Direction, Direction]:
        epoch = max(self.sender.epoch, self.receiver.epoch) + 1
        self._exporter = self._exporter.update(epoch.to_bytes(8))
        return self._derive(epoch)

    def next_sender(self) -> None:
        if self.sender.epoch > self.receiver.epoch:
            raise ProtocolViolation("a second rekey before the peer followed the first")
        if self._waiting is not None:
            self.sender, self._waiting = self._waiting, None
        else:
            self.sender, self._waiting = self._advance()

    def next_receiver(self) -> None:
        if self.receiver.epoch > self.sender.epoch:
            raise ProtocolViolation("the peer renewed its keys twice in a row")
        if self._waiting is not None:
            self.receiver, self._waiting = self._waiting, None
        elif self.receiver.records < 2:  # the REKEY record itself is one
            raise ProtocolViolation("the peer renews keys that it has not used")
        else:
            self._waiting, self.receiver = self._advance()


def padded(plaintext: Bytes, multiple: int) -> bytes | None:
    """The plaintext, %x01, and zeros up to a multiple of so many bytes, or to the longest allowed. None: it
    is the longest allowed."""
    room = MAX_PLAINTEXT - len(plaintext)
    if room == 0:
        return None
    return bytes(plaintext) + b"\1".ljust(min(room, multiple - len(plaintext) % multiple), b"\0")


def unpadded(plaintext: bytes) -> bytes:
    data = plaintext.rstrip(b"\0")
    if not data[:-1] or data[-1] != 1:
        raise ProtocolViolation("a padded record without data, or without its end")
    return data[:-1]


def fragments(pieces: Sequence[Bytes]) -> Iterator[Bytes]:
    joined: list[Bytes] = []
    size = 0
    for piece in pieces:
        view = piece if isinstance(piece, bytes) else memoryview(piece).cast("B")
        length = len(view)
        if joined and (length >= JOIN_PIECES_BELOW or size + length > MAX_PLAINTEXT):
            yield b"".join(joined)
            joined, size = [], 0
        if length >= JOIN_PIECES_BELOW:
            whole = memoryview(view)
            for start in range(0, length, MAX_PLAINTEXT):
                yield whole[start : start + MAX_PLAINTEXT]
        elif length:
            joined.append(view)
            size += length
    if joined:
        yield b"".join(joined)
