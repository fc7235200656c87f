"""Pictures and what was read in them, between web process, supervisor and worker. Pure.

A picture is read in a process without rights (`worker`); neither of the other two decodes anything. A frame
is a length (4 bytes, network byte order) and so many bytes: a picture as it came one way, `[0, text]` (empty:
no code) or `[1, message, hint]` in deterministic CBOR the other way.
"""

from functools import partial
from typing import Final, NamedTuple, TypeAlias

from ca.encoding import decode, encode
from ca.enrollment.qr import MAX_TEXT
from ca.errors import EncodingError
from rossec.errors import KeyMessageRefused

HEAD: Final = 4
MAX_PICTURE: Final = 256 * 1024
MAX_ANSWER: Final = 4096


class Found(NamedTuple):
    text: str  # of the code in a picture; empty: there is none


class Unreadable(NamedTuple):
    message: str
    hint: str


Answer: TypeAlias = Found | Unreadable


def frame(body: bytes) -> bytes:
    return len(body).to_bytes(HEAD) + body


def size(head: bytes, limit: int) -> int:
    found = int.from_bytes(head)
    if not 0 < found <= limit:
        raise KeyMessageRefused(f"a picture's frame of {found} bytes where {limit} are allowed")
    return found


answer_size: Final = partial(size, limit=MAX_ANSWER)


def write_answer(answer: Answer) -> bytes:
    return frame(encode([0 if isinstance(answer, Found) else 1, *answer]))


def read_answer(body: bytes) -> Answer:
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
