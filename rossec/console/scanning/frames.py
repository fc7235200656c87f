"""Pictures and what was read in them, between web process, supervisor and worker. Pure.

A frame is a length (4 bytes, network byte order) and so many bytes: a picture as it came one way,
`[0, text]` (empty: no code) or `[1, message, hint]` in deterministic CBOR the other way.
"""

from typing import Final, NamedTuple

from ca.encoding import decode, encode
from ca.enrollment.qr import MAX_TEXT
from ca.errors import EncodingError
from rossec.errors import KeyMessageRefused

HEAD: Final = 4
MAX_PICTURE: Final = 256 * 1024
MAX_ANSWER: Final = 4096


class Found(NamedTuple):
    """The text of the code in a picture; empty: there is none."""

    text: str


class Unreadable(NamedTuple):
    """Why a picture could not be read."""

    message: str
    hint: str


def frame(body: bytes) -> bytes:
    """A body with its length in front."""
    return len(body).to_bytes(HEAD) + body


def size(head: bytes, limit: int) -> int:
    """The number of bytes after a frame's head.

    Raises:
        KeyMessageRefused: none, or more than `limit`.
    """
    found = int.from_bytes(head)
    if not 0 < found <= limit:
        raise KeyMessageRefused(f"a picture's frame of {found} bytes where {limit} are allowed")
    return found


def write_answer(answer: Found | Unreadable) -> bytes:
    """The frame of an answer."""
    return frame(encode([0 if isinstance(answer, Found) else 1, *answer]))


def read_answer(body: bytes) -> Found | Unreadable:
    """Read the body of an answer's frame.

    Raises:
        KeyMessageRefused: malformed.
    """
    try:
        match decode(body, limit=MAX_ANSWER):
            case [0, str() as text] if len(text) <= MAX_TEXT:
                return Found(text)
            case [1, str() as message, str() as hint]:
                return Unreadable(message, hint)
            case _:
                pass
    except EncodingError as error:
        raise KeyMessageRefused(f"a scanner's answer that is malformed: {error}") from error
    raise KeyMessageRefused("a scanner's answer of another form")
