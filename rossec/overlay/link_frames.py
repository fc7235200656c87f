"""The frames of a link, written, and read strictly; keys of inboxes. Pure. docs/spec/overlay.md section 3.

    kind(1) link(16) offset(8) received(8) limit(8) body

Every frame says how far the sender of it has received, and how far it may be sent to. Nothing in it is
authenticated: the bytes that it carries are, inside. An inbox is `rossec/1/<account>/<box>`: its key has no
name, label, domain or topic in it.
"""

import re
from enum import IntEnum
from struct import Struct
from typing import Final, NamedTuple

from rossec.channel.records import HEADER, MAX_PLAINTEXT, TAG, Bytes
from rossec.errors import LinkEnded

BOX: Final = 16  # bytes
_KEY: Final = re.compile(r"rossec/1/[a-z0-9]{1,32}/[0-9a-f]{32}")
_ACCOUNT: Final = re.compile(r"[a-z0-9]{1,32}")
_HEAD: Final = Struct(">B16sQQQ")
_RANGE: Final = Struct(">QQ")
HEAD: Final = _HEAD.size
MAX_BODY: Final = HEADER + MAX_PLAINTEXT + TAG  # a whole record
MAX_FRAME: Final = HEAD + MAX_BODY
LINK_ID: Final = 16
OPEN_SIZE: Final = 600  # octets at least: three times that is room for EDHOC's message_2
MAX_RANGES: Final = 32
_LAST: Final = 1 << 62


def is_account(name: str) -> bool:
    return _ACCOUNT.fullmatch(name) is not None


def is_inbox(key: str) -> bool:
    return _KEY.fullmatch(key) is not None


def inbox(account: str, box: bytes) -> str:
    """The key of the inbox `box` (16 random bytes) of an account."""
    key = f"rossec/1/{account}/{box.hex()}"
    if not is_inbox(key):
        raise ValueError("not the key of an inbox")
    return key


class LinkFrameKind(IntEnum):
    OPEN = 1  # the first of a link, with where to answer
    DATA = 2
    ACK = 3  # offset: how far the peer's frames were seen to go; body: what came beyond `received`
    RESET = 4
    END = 5  # nothing more follows; counts as one byte
    PROBE = 6  # asks for an ACK; offset: how far its sender's frames go


_LENGTHS: Final[dict[int, tuple[int, int]]] = {
    LinkFrameKind.OPEN: (OPEN_SIZE - HEAD, MAX_BODY),
    LinkFrameKind.DATA: (1, MAX_BODY),
    LinkFrameKind.ACK: (0, MAX_RANGES * _RANGE.size),
    LinkFrameKind.RESET: (0, 0),
    LinkFrameKind.END: (0, 0),
    LinkFrameKind.PROBE: (0, OPEN_SIZE),
}


class LinkFrame(NamedTuple):
    kind: int
    link: bytes
    offset: int
    received: int
    limit: int
    body: memoryview


def head(kind: LinkFrameKind, link: bytes, offset: int, received: int, limit: int) -> bytes:
    return _HEAD.pack(kind, link, offset, received, limit)


def link_of(data: bytes) -> bytes | None:
    # To find who reads the frame; None: too short to be one.
    return data[1 : 1 + LINK_ID] if HEAD <= len(data) <= MAX_FRAME else None


def kind_of(data: bytes) -> int:
    return data[0]


def read(data: bytes) -> LinkFrame:
    if not HEAD <= len(data) <= MAX_FRAME:
        raise LinkEnded("a frame of a forbidden length")
    kind, link, offset, received, limit = _HEAD.unpack_from(data)
    shortest, longest = _LENGTHS.get(kind, (1, 0))
    if not shortest <= len(data) - HEAD <= longest:
        raise LinkEnded("a frame of an unknown kind, or of a length that its kind cannot have")
    if offset > _LAST or limit > _LAST or received > _LAST:
        raise LinkEnded("a frame with an offset that no link reaches")
    return LinkFrame(kind, link, offset, received, limit, memoryview(data)[HEAD:])


def return_address(reply_key: str, size: int) -> bytes:
    key = reply_key.encode("ascii")
    padding = max(0, size - 3 - len(key))
    return bytes((len(key),)) + key + padding.to_bytes(2) + bytes(padding)


def split_return_address(body: memoryview) -> tuple[str, memoryview]:
    """The inbox to answer to, and the bytes after the padding."""
    length = body[0] if body else 0
    key = bytes(body[1 : 1 + length]).decode("ascii", "replace")
    padding = int.from_bytes(body[1 + length : 3 + length])
    begin = 3 + length + padding
    # A key with a wildcard would be put to many inboxes.
    if begin > len(body) or not is_inbox(key):
        raise LinkEnded("a frame that does not say where to answer")
    if any(body[3 + length : begin]):
        raise LinkEnded("padding that is not zero")
    return key, body[begin:]


def pack_ranges(ranges: list[tuple[int, int]]) -> bytes:
    return b"".join(_RANGE.pack(first, end) for first, end in ranges[:MAX_RANGES])


def read_ranges(frame: LinkFrame) -> list[tuple[int, int]]:
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
    return b"".join((head_, *pieces))


def refusal(frame: bytes) -> tuple[str, bytes] | None:
    """What to put where, when a frame of an unknown link arrives: a RESET for a PROBE; None: nothing."""
    # So a relay that was started again ends at once what it knows nothing of.
    if kind_of(frame) != LinkFrameKind.PROBE:
        return None
    try:
        probe = read(frame)
        reply_key, _ = split_return_address(probe.body)
    except LinkEnded:
        return None
    return reply_key, head(LinkFrameKind.RESET, probe.link, 0, 0, 0)
