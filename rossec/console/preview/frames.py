"""Messages on the way from the process that receives them to the pages. Pure.

A frame is a length (4 bytes, network byte order) and so many bytes of deterministic CBOR:
`[topic, type, milliseconds since the epoch, data]`. The length is checked before the rest is read.
"""

from typing import Final

from ca.encoding import decode
from ca.errors import EncodingError
from rossec.authority.keyservice.messages import HEAD, frame, frame_size
from rossec.console.preview.memory import PreviewMessage
from rossec.errors import KeyMessageRefused

MAX_DATA: Final = 1024 * 1024  # of one message; a larger one is not drawn
MAX_FRAME: Final = MAX_DATA + 4096
__all__ = ["HEAD", "MAX_DATA", "read", "size", "write"]


def write(message: PreviewMessage) -> bytes:
    """The frame of a message."""
    return frame([message.topic, message.type, int(message.at * 1000), message.data])


def size(head: bytes) -> int:
    """The number of bytes that follow the head.

    Raises:
        KeyMessageRefused: none, or too many.
    """
    return frame_size(head, MAX_FRAME)


def read(body: bytes) -> PreviewMessage:
    """Read the body of a frame.

    Raises:
        KeyMessageRefused: it is not a message.
    """
    try:
        value = decode(body, limit=MAX_FRAME)
    except EncodingError as error:
        raise KeyMessageRefused(f"a message of the preview that is malformed: {error}") from error
    match value:
        case [str(topic), str(kind), int(at), bytes(data)] if not isinstance(at, bool) and at >= 0:
            return PreviewMessage(topic, kind, at / 1000, data)
        case _:
            raise KeyMessageRefused("a message of the preview that is malformed")
