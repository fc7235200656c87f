"""Messages deflated for a slow line (RFC 1951), and inflated within bounds. Pure.

A deflated connection carries TCPROS frames whose content is `00 message`, or `01 size data`, with
the size of the message in 4 bytes, little endian. Each message is compressed for itself: no length
depends on another one, so none tells what a grant withheld. It is compressed after filters, so its
length tells no more than what its receiver reads. `size` is compared with the limit before anything
is inflated, and no more than that many bytes ever are; a bomb costs what a message of that size
costs, and ends its connection.
"""

import struct
import zlib
from collections.abc import Sequence
from threading import Lock
from typing import Final
from weakref import ref

from grants.filters.codegen import Buffer
from rossec.errors import FrameRefused

STORED, DEFLATED = b"\0", b"\1"
OVERHEAD: Final = 1
"""Bytes that a content is longer than its message at most."""
LARGE: Final = 64 * 1024
"""A message from this size on is not deflated, or inflated, in the turn of an event loop."""
_LEVEL: Final = 1  # higher ones take twice to four times as long, for a few per cent
_SHORTEST: Final = 64  # bytes; below it there is nothing to gain
_RAW: Final = -zlib.MAX_WBITS  # no header and no checksum: the channel authenticates
_SIZE: Final = struct.Struct("<I")
_START: Final = len(DEFLATED) + _SIZE.size


def deflated(pieces: Sequence[Buffer]) -> bytes:
    """The content for a message in pieces: deflated if it is shorter then, else as it is."""
    size = sum(map(len, pieces))
    if size >= _SHORTEST:
        engine = zlib.compressobj(_LEVEL, zlib.DEFLATED, _RAW)
        parts = [*map(engine.compress, pieces), engine.flush()]
        content = b"".join((DEFLATED, _SIZE.pack(size), *parts))
        if len(content) <= size:
            return content
    return b"".join((STORED, *pieces))


def claimed_size(content: bytes, limit: int) -> int:
    """The size of the message that `content` says it has.

    Raises:
        FrameRefused: more than `limit`, no more than the content itself, or no content.
    """
    if content[:1] == STORED:
        size = len(content) - 1
    elif content[:1] == DEFLATED and len(content) > _START:
        (size,) = _SIZE.unpack_from(content, 1)
        if size < len(content):
            raise FrameRefused(f"a message of {size} bytes that is longer when deflated")
    else:
        raise FrameRefused("a frame that is neither deflated nor as it is")
    if size > limit:
        raise FrameRefused(f"a deflated message of {size} bytes, at most {limit} allowed")
    return size


def inflated(content: bytes, limit: int) -> bytes:
    """The message of `content`, at most `limit` bytes.

    Raises:
        FrameRefused: as `claimed_size`; or it is not what it says, or more follows it.
    """
    size = claimed_size(content, limit)
    if content[:1] == STORED:
        return content[1:]
    engine = zlib.decompressobj(_RAW)
    try:
        # One byte more, for the end of the data to be read; zero would mean no limit.
        message = engine.decompress(memoryview(content)[_START:], size + 1)
    except zlib.error:
        raise FrameRefused("a deflated message that cannot be inflated") from None
    if len(message) != size or not engine.eof or engine.unused_data:
        raise FrameRefused(f"a deflated message that has not the {size} bytes it says")
    return message


class Deflatable:
    """A message that is deflated once, when it is first sent; threads share it."""

    __slots__ = ("__weakref__", "_content", "_lock", "pieces", "source")

    def __init__(self, pieces: Sequence[Buffer], source: object) -> None:
        self.pieces = pieces
        self.source = source
        self._content: bytes | None = None
        self._lock = Lock()

    def content(self) -> bytes:
        """What is sent of it."""
        with self._lock:
            if self._content is None:
                self._content = deflated(self.pieces)
            return self._content


class SharedDeflation:
    """Gives the receivers of one filtered message the same `Deflatable`.

    It keeps a small one until the next message: it may be sent before it is queued for the next
    receiver. A large one takes longer than that, and its memory is freed with the last receiver.
    """

    def __init__(self) -> None:
        self._last: ref[Deflatable] | None = None
        self._kept: Deflatable | None = None

    def of(self, pieces: Sequence[Buffer], source: object) -> Deflatable:
        """That of the message in `pieces`: the last one, if `source` is the object it was then."""
        last = None if self._last is None else self._last()
        if last is None or last.source is not source:
            last = Deflatable(pieces, source)
            self._last = ref(last)
            self._kept = last if sum(map(len, pieces)) < LARGE else None
        return last
