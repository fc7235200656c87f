"""Service calls on the wire, after the connection headers: requests and responses as bytes.

A request is a frame. A response is the byte 1 and a frame, or the byte 0 and a frame that holds the
reason as text. Client and server alternate: more than one frame at a time is a protocol
error, so readers use `FrameReader.feed_one`.
"""

import struct
from collections.abc import Sequence
from typing import Final

from rossec.errors import FrameRefused, ServiceFailed
from rossec.ros.header import MESSAGE_LIMIT, FrameReader
from rossec.ros.text import printable

REQUEST_LIMIT: Final = 16 * 1024 * 1024
_ERROR_LIMIT: Final = 4096
_LENGTH: Final = struct.Struct("<I")
_OK: Final = b"\1"
_FAILED: Final = b"\0"

Buffer = bytes | bytearray | memoryview


def request_reader() -> FrameReader:
    """For the server, after the connection header."""
    return FrameReader(REQUEST_LIMIT)


def response_reader() -> FrameReader:
    """For the client, after the connection header."""
    return FrameReader(MESSAGE_LIMIT, lead=len(_OK))


def framed(message: Sequence[Buffer]) -> list[Buffer]:
    """A request: the pieces of one message with their length in front."""
    return [_LENGTH.pack(sum(map(len, message))), *message]


def success(message: Sequence[Buffer]) -> list[Buffer]:
    """A response."""
    return [_OK, *framed(message)]


def failure(reason: str) -> list[Buffer]:
    """A failure with its reason."""
    return [_FAILED, *framed([reason.encode()[:_ERROR_LIMIT].decode(errors="ignore").encode()])]


def open_response(content: bytes) -> bytes:
    """The message in what `response_reader` returned.

    Raises:
        ServiceFailed: the provider failed, with its reason.
        FrameRefused: neither.
    """
    mark, message = content[:1], content[1:]
    if mark == _FAILED:
        text = message.decode(errors="replace")
        raise ServiceFailed(printable(text, _ERROR_LIMIT) or "the service failed without a reason")
    if mark != _OK:
        raise FrameRefused("a response that is neither a success nor a failure")
    return message
