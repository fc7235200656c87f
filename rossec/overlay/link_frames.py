"""The frames of a link, docs/spec/overlay.md section 3: written, and read strictly. Pure.

```
kind(1) link(16) offset(8) received(8) limit(8) body
```

Every frame says how far the sender of it has received, and how far it may be sent to. Nothing in it
is authenticated: the bytes that it carries are, inside. What is not in form is `LinkEnded`.
"""

from dataclasses import dataclass
from enum import IntEnum
from struct import Struct
from typing import Final

from rossec.channel.records import HEADER, MAX_PLAINTEXT, TAG, Bytes
from rossec.errors import LinkEnded
from rossec.overlay.mailboxes import is_mailbox

_HEAD: Final = Struct(">B16sQQQ")
_RANGE: Final = Struct(">QQ")

HEAD: Final = _HEAD.size
MAX_BODY: Final = HEADER + MAX_PLAINTEXT + TAG  # a whole record
MAX_FRAME: Final = HEAD + MAX_BODY
LINK_ID: Final = 16
OPEN_SIZE: Final = 600  # octets at least: three times that is room for EDHOC's message_2
MAX_RANGES: Final = 32
_LAST: Final = 1 << 62


class Kind(IntEnum):
    """What a frame is."""

    OPEN = 1  # the first of a link, with where to answer
    DATA = 2
    ACK = 3  # offset: how far the peer's frames were seen to go; body: what came beyond `received`
    RESET = 4
    END = 5  # nothing more follows; counts as one byte
    PROBE = 6  # asks for an ACK; offset: how far its sender's frames go


_LENGTHS: Final[dict[int, tuple[int, int]]] = {
    Kind.OPEN: (OPEN_SIZE - HEAD, MAX_BODY),
    Kind.DATA: (1, MAX_BODY),
    Kind.ACK: (0, MAX_RANGES * _RANGE.size),
    Kind.RESET: (0, 0),
    Kind.END: (0, 0),
    Kind.PROBE: (0, OPEN_SIZE),
}


@dataclass(frozen=True, slots=True)
class Frame:
    """A frame in form; `body` is a view of what was received."""

    kind: int
    link: bytes
    offset: int
    received: int
    limit: int
    body: memoryview


def head(kind: Kind, link: bytes, offset: int, received: int, limit: int) -> bytes:
    """What stands before the body."""
    return _HEAD.pack(kind, link, offset, received, limit)


def link_of(data: bytes) -> bytes | None:
    """The link that a frame is of, to find who reads it; None: too short to be a frame."""
    return data[1 : 1 + LINK_ID] if HEAD <= len(data) <= MAX_FRAME else None


def kind_of(data: bytes) -> int:
    """The kind of a frame that `link_of` knows a link of."""
    return data[0]


def read(data: bytes) -> Frame:
    """Read one frame.

    Raises:
        LinkEnded: not in form.
    """
    if not HEAD <= len(data) <= MAX_FRAME:
        raise LinkEnded("a frame of a forbidden length")
    kind, link, offset, received, limit = _HEAD.unpack_from(data)
    shortest, longest = _LENGTHS.get(kind, (1, 0))
    if not shortest <= len(data) - HEAD <= longest:
        raise LinkEnded("a frame of an unknown kind, or of a length that its kind cannot have")
    if offset > _LAST or limit > _LAST or received > _LAST:
        raise LinkEnded("a frame with an offset that no link reaches")
    return Frame(kind, link, offset, received, limit, memoryview(data)[HEAD:])


def return_address(reply_key: str, size: int) -> bytes:
    """The body of a PROBE, and the beginning of that of an OPEN: where to answer, and padding.

    Args:
        reply_key: the mailbox in which the sender waits.
        size: how long the body has to be at least.
    """
    key = reply_key.encode("ascii")
    padding = max(0, size - 3 - len(key))
    return bytes((len(key),)) + key + padding.to_bytes(2) + bytes(padding)


def split_return_address(body: memoryview) -> tuple[str, memoryview]:
    """The mailbox to answer to, and the bytes after the padding.

    Raises:
        LinkEnded: not in form, not the key of a mailbox, or padding that is not zero.
    """
    length = body[0] if body else 0
    key = bytes(body[1 : 1 + length]).decode("ascii", "replace")
    padding = int.from_bytes(body[1 + length : 3 + length])
    begin = 3 + length + padding
    if begin > len(body) or not is_mailbox(key):
        raise LinkEnded("a frame that does not say where to answer")
    if any(body[3 + length : begin]):
        raise LinkEnded("padding that is not zero")
    return key, body[begin:]


def pack_ranges(ranges: list[tuple[int, int]]) -> bytes:
    """The body of an ACK: (first, end) of what came beyond the first gap, in order."""
    return b"".join(_RANGE.pack(first, end) for first, end in ranges[:MAX_RANGES])


def read_ranges(frame: Frame) -> list[tuple[int, int]]:
    """The ranges of an ACK.

    Raises:
        LinkEnded: not in order, overlapping, or beyond what was seen.
    """
    if len(frame.body) % _RANGE.size:
        raise LinkEnded("an acknowledgement with half a range")
    ranges = list(_RANGE.iter_unpack(frame.body))
    last = frame.received
    for first, end in ranges:
        if not last < first < end <= frame.offset:
            raise LinkEnded("an acknowledgement with ranges out of order")
        last = end
    return ranges


def joined(head_: bytes, pieces: list[Bytes]) -> bytes:
    """A frame of its head and the pieces of its body: the one copy that is made of them."""
    return b"".join((head_, *pieces))


def refusal(frame: bytes) -> tuple[str, bytes] | None:
    """What to put where, when a PROBE arrives of a link that is not known here: a RESET.

    So a relay that was started again ends at once what it knows nothing of. None: nothing, as for
    every other frame of an unknown link.
    """
    if kind_of(frame) != Kind.PROBE:
        return None
    try:
        probe = read(frame)
        reply_key, _ = split_return_address(probe.body)
    except LinkEnded:
        return None
    return reply_key, head(Kind.RESET, probe.link, 0, 0, 0)
