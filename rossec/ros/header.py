"""TCPROS connection headers and message frames, as bytes.

Both are length-prefixed, little endian, 32 bits: a header is a frame whose content is a sequence
of length-prefixed `key=value` fields. Every length is compared with its limit when its fourth byte
arrives, before anything is allocated for it (stock roscpp allows a gigabyte, rospy any header).
A reader that refused a frame refuses all that follow: the frame boundaries are lost.
"""

import struct
from collections.abc import Mapping
from typing import Final

from rossec.errors import FrameRefused, HeaderRefused

HEADER_LIMIT: Final = 64 * 1024
FIELD_LIMIT: Final = (
    48 * 1024
)  # below the header limit, to leave room for other fields: definitions reach 20 kB
MESSAGE_LIMIT: Final = 64 * 1024 * 1024
_ERROR_TEXT_LIMIT: Final = 1024
_LENGTH: Final = struct.Struct("<I")


def encode(fields: Mapping[str, str | bytes], *, limit: int = HEADER_LIMIT) -> bytes:
    """The header with its total length in front, ready to send.

    Raises:
        HeaderRefused: a key is empty, not ASCII or holds '=', or the header is too long.
    """
    body = b"".join(_encode_field(key, value) for key, value in fields.items())
    if len(body) > limit:
        raise HeaderRefused(f"a connection header of {len(body)} bytes, at most {limit} allowed")
    return _LENGTH.pack(len(body)) + body


def decode(
    body: bytes, *, limit: int = HEADER_LIMIT, field_limit: int = FIELD_LIMIT
) -> dict[str, bytes]:
    """The fields of a header; `body` is the content of its frame, without the total length.

    Raises:
        HeaderRefused: too long, a field without '=', a key twice, or bytes left over.
    """
    if len(body) > limit:
        raise HeaderRefused(f"a connection header of {len(body)} bytes, at most {limit} allowed")
    fields: dict[str, bytes] = {}
    position = 0
    while position < len(body):
        field, position = _take_field(body, position, field_limit)
        key, value = _split_field(field)
        if key in fields:
            raise HeaderRefused(f"the header field {key!r} appears twice")
        fields[key] = value
    return fields


def text(fields: Mapping[str, bytes], key: str, default: str | None = None) -> str:
    """A field that must be UTF-8 text.

    Raises:
        HeaderRefused: missing without a default, or not UTF-8.
    """
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
    """A header that makes rospy and roscpp log `message` and close this connection."""
    return encode({"error": message.encode()[:_ERROR_TEXT_LIMIT].decode(errors="ignore")})


def frame(message: bytes) -> bytes:
    """One message with its length in front."""
    return _LENGTH.pack(len(message)) + message


class FrameReader:
    """Splits a byte stream into frames.

    Args:
        limit: largest frame content, in bytes.
        first: another limit for the first frame, the connection header.
        lead: bytes before the length of every frame but a header (a service reply's `ok` byte);
            they stay in front of the frame's content.
    """

    def __init__(
        self, limit: int = MESSAGE_LIMIT, *, first: int | None = None, lead: int = 0
    ) -> None:
        self._buffer = bytearray()
        self._limit = limit
        self._first = first
        self._lead = lead
        self._refusal: str | None = None

    @property
    def pending(self) -> int:
        """Bytes received that do not complete a frame yet."""
        return len(self._buffer)

    def feed(self, data: bytes | memoryview) -> list[bytes]:
        """All frames that `data` completes.

        Raises:
            FrameRefused: a frame is longer than allowed. Frames before it are lost with it.
        """
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
        """Take complete frames straight from `data`, without the buffer; returns the rest."""
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
        """The frame that `data` completes, where none may follow before this one is answered.

        Raises:
            FrameRefused: it is longer than allowed, or more follows it.
        """
        self._buffer += data
        content = self._next()
        if content is not None and self._buffer:
            raise self._refuse("bytes after a frame, before its answer")
        return content

    def _next(self) -> bytes | None:
        if self._refusal is not None:
            self._buffer.clear()
            raise FrameRefused(self._refusal)
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

    def _refuse(self, reason: str) -> FrameRefused:
        self._buffer.clear()
        self._refusal = reason
        return FrameRefused(reason)


def _encode_field(key: str, value: str | bytes) -> bytes:
    if not key or "=" in key or not key.isascii():
        raise HeaderRefused(f"{key!r} cannot be the key of a header field")
    raw = value.encode() if isinstance(value, str) else value
    field = key.encode() + b"=" + raw
    return _LENGTH.pack(len(field)) + field


def _take_field(body: bytes, position: int, limit: int) -> tuple[bytes, int]:
    start = position + _LENGTH.size
    if start > len(body):
        raise HeaderRefused("a header that ends inside a length")
    length: int = _LENGTH.unpack_from(body, position)[0]
    if length > limit:
        raise HeaderRefused(f"a header field of {length} bytes, at most {limit} allowed")
    if start + length > len(body):
        raise HeaderRefused("a header field that reaches beyond its header")
    return body[start : start + length], start + length


def _split_field(field: bytes) -> tuple[str, bytes]:
    key, separator, value = field.partition(b"=")
    if not separator:
        raise HeaderRefused("a header field without '='")
    if not key or not key.isascii():
        raise HeaderRefused("a header field whose key is empty or not ASCII")
    return key.decode(), value
