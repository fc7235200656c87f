"""TCPROS connection headers, message frames and service calls, as bytes. Pure.

All are length-prefixed, little endian, 32 bits: a header is a frame whose content is a sequence of
length-prefixed `key=value` fields, a service's request is a frame, its response the byte 1 and a
frame, or the byte 0 and a frame that holds the reason as text. Every length is compared with its
limit when its fourth byte arrives, before anything is allocated for it (stock roscpp allows a
gigabyte, rospy any header). A reader that refused a frame refuses all that follow: the frame
boundaries are lost.
"""

import struct
from collections.abc import Mapping, Sequence
from typing import Final

from rossec.errors import HeaderRefused, ServiceFailed, WireError
from rossec.peer_limits import STEP, Progress, printable

HEADER_LIMIT: Final = 64 * 1024
FIELD_LIMIT: Final = 48 * 1024  # below that limit, to leave room for other fields: definitions reach 20 kB
MESSAGE_LIMIT: Final = 64 * 1024 * 1024
REQUEST_LIMIT: Final = 16 * 1024 * 1024
# How long to wait for more of a message before `Framing.check_progress`, in seconds
PATIENCE: Final = float(STEP)
_ERROR_TEXT_LIMIT: Final = 1024  # of a header
_ERROR_LIMIT: Final = 4096  # of a service
_LENGTH: Final = struct.Struct("<I")
_OK: Final = b"\1"
_FAILED: Final = b"\0"

Buffer = bytes | bytearray | memoryview


def encode(fields: Mapping[str, str | bytes], *, limit: int = HEADER_LIMIT) -> bytes:
    body = b""
    for key, value in fields.items():
        if not key or "=" in key or not key.isascii():
            raise HeaderRefused(f"{key!r} cannot be the key of a header field")
        raw = value.encode() if isinstance(value, str) else value
        body += frame(key.encode() + b"=" + raw)
    if len(body) > limit:
        raise HeaderRefused(f"a connection header of {len(body)} bytes, at most {limit} allowed")
    return frame(body)


def decode(body: bytes, *, limit: int = HEADER_LIMIT, field_limit: int = FIELD_LIMIT) -> dict[str, bytes]:
    if len(body) > limit:
        raise HeaderRefused(f"a connection header of {len(body)} bytes, at most {limit} allowed")
    fields: dict[str, bytes] = {}
    position = 0
    while position < len(body):
        # 1. The length of a field.
        start = position + _LENGTH.size
        if start > len(body):
            raise HeaderRefused("a header that ends inside a length")
        length: int = _LENGTH.unpack_from(body, position)[0]
        if length > field_limit:
            raise HeaderRefused(f"a header field of {length} bytes, at most {field_limit} allowed")
        position = start + length
        if position > len(body):
            raise HeaderRefused("a header field that reaches beyond its header")
        # 2. Its key and value.
        raw, separator, value = body[start:position].partition(b"=")
        if not separator:
            raise HeaderRefused("a header field without '='")
        if not raw or not raw.isascii():
            raise HeaderRefused("a header field whose key is empty or not ASCII")
        key = raw.decode()
        if key in fields:
            raise HeaderRefused(f"the header field {key!r} appears twice")
        fields[key] = value
    return fields


def text(fields: Mapping[str, bytes], key: str, default: str | None = None) -> str:
    value = fields.get(key)
    if value is None:
        if default is None:
            raise HeaderRefused(f"the header field {key!r} is missing")
        return default
    try:
        return value.decode()
    except UnicodeDecodeError as error:
        raise HeaderRefused(f"the header field {key!r} is not UTF-8") from error


def error_header(message: str) -> bytes:
    return encode({"error": message.encode()[:_ERROR_TEXT_LIMIT].decode(errors="ignore")})


def frame(message: bytes) -> bytes:
    return _LENGTH.pack(len(message)) + message


class FrameReader:
    """Splits a byte stream into frames."""

    def __init__(self, limit: int = MESSAGE_LIMIT, *, first: int | None = None, lead: int = 0) -> None:
        self._buffer = bytearray()
        self._limit = limit  # largest frame content, in bytes
        self._first = first  # another limit for the first frame, the connection header
        # bytes before the length of every frame but a header (a service reply's `ok` byte); they stay in
        # front of the frame's content
        self._lead = lead
        self._refusal: str | None = None

    @property
    def pending(self) -> int:
        """Bytes received that do not complete a frame yet."""
        return len(self._buffer)

    def feed(self, data: bytes | memoryview) -> list[bytes]:
        """All frames that `data` completes."""
        frames: list[bytes] = []
        if self._first is None and not self._lead and self._refusal is None:
            if not self._buffer:
                data = self._cut(data, frames)
            elif len(self._buffer) == _LENGTH.size and self._checked_length(0) == len(data):
                self._buffer.clear()
                return [bytes(data)]  # no copy if it is bytes
        self._buffer += data
        while (content := self._next()) is not None:
            frames.append(content)
        return frames

    def _cut(self, data: bytes | memoryview, frames: list[bytes]) -> memoryview:
        view, position, size = memoryview(data), 0, len(data)
        while position + _LENGTH.size <= size:
            length: int = _LENGTH.unpack_from(view, position)[0]
            start = position + _LENGTH.size
            if length > self._limit or start + length > size:
                break
            position = start + length
            frames.append(bytes(view[start:position]))
        return view[position:]

    def feed_one(self, data: bytes) -> bytes | None:
        """The frame that `data` completes, where none may follow before this one is answered."""
        self._buffer += data
        content = self._next()
        if content is not None and self._buffer:
            raise self._refuse("bytes after a frame, before its answer")
        return content

    def _next(self) -> bytes | None:
        if self._refusal is not None:
            self._buffer.clear()
            raise WireError(self._refusal)
        lead = 0 if self._first is not None else self._lead
        start = lead + _LENGTH.size
        if len(self._buffer) < start:
            return None
        end = start + self._checked_length(lead)
        if len(self._buffer) < end:
            return None
        with memoryview(self._buffer) as view:
            content = bytes(view[:lead]) + view[start:end] if lead else bytes(view[start:end])
        del self._buffer[:end]
        self._first = None
        return content

    def _checked_length(self, position: int) -> int:
        length: int = _LENGTH.unpack_from(self._buffer, position)[0]
        limit = self._limit if self._first is None else self._first
        if length > limit:
            raise self._refuse(f"a frame of {length} bytes, at most {limit} allowed")
        return length

    def _refuse(self, reason: str) -> WireError:
        self._buffer.clear()
        self._refusal = reason
        return WireError(reason)


class Framing:
    """Splits a byte stream into messages, and refuses one that takes too long (`Progress`)."""

    # Units need not end where messages do: a sidecar forwards what its program writes. So the rule for a unit
    # applies to a message as well. `now` is in seconds, of any clock.
    def __init__(self, reader: FrameReader) -> None:
        self._reader = reader
        self._progress = Progress()

    @property
    def incomplete(self) -> bool:
        return self._reader.pending > 0

    def feed(self, data: bytes | memoryview, now: int) -> list[bytes]:
        messages = self._reader.feed(data)
        if messages:
            self._progress.done()
        self.check_progress(now)
        return messages

    def feed_one(self, data: bytes, now: int) -> bytes | None:
        """As `FrameReader.feed_one`; raises as `feed`."""
        message = self._reader.feed_one(data)
        if message is not None:
            self._progress.done()
        self.check_progress(now)
        return message

    def check_progress(self, now: int) -> None:
        if self._reader.pending > 0:
            self._progress.check(now, self._reader.pending)


# Client and server alternate: more than one frame at a time is a protocol error, so readers of services
# use `FrameReader.feed_one`.


def request_reader() -> FrameReader:
    return FrameReader(REQUEST_LIMIT)


def response_reader() -> FrameReader:
    return FrameReader(MESSAGE_LIMIT, lead=len(_OK))


def framed(message: Sequence[Buffer]) -> list[Buffer]:
    return [_LENGTH.pack(sum(map(len, message))), *message]


def success(message: Sequence[Buffer]) -> list[Buffer]:
    return [_OK, *framed(message)]


def failure(reason: str) -> list[Buffer]:
    return [_FAILED, *framed([reason.encode()[:_ERROR_LIMIT].decode(errors="ignore").encode()])]


def open_response(content: bytes) -> bytes:
    mark, message = content[:1], content[1:]
    if mark == _FAILED:
        text = message.decode(errors="replace")
        raise ServiceFailed(printable(text, _ERROR_LIMIT) or "the service failed without a reason")
    if mark != _OK:
        raise WireError("a response that is neither a success nor a failure")
    return message
