"""The receive buffer: the socket writes into it, frames are parsed and decrypted from it in place.

Bytes are moved only when an incomplete frame has reached the end of the buffer. It grows by what
has arrived, not by what a header announces: to twice the size when it is full, and for a peer that
is authenticated at once to eight times the bytes that are there. An idle connection has none: an
empty buffer is freed, but not one for large frames while many of them arrive.
"""

from typing import Final

FIRST: Final = 256
"""For the opening of a caller and its message_1: what one that says nothing more costs."""
SMALL: Final = 2 * 1024
"""Before authentication, and no more until it is full; most messages of a handshake fit."""
OPEN: Final = 8 * 1024
"""After it: several small records fit."""


_GIVE_BACK: Final = 64 * 1024  # larger buffers are kept: allocating them again costs too much
_EARNED: Final = 8  # bytes of room for each that arrived: from 8 KiB to the largest size in 2 steps
_NOTHING: Final = bytearray()
_NO_VIEW: Final = memoryview(_NOTHING)


class ReceiveBuffer:
    """A byte queue whose free tail is lent to the reader of the socket."""

    __slots__ = ("_data", "_end", "_least", "_start", "_view")

    def __init__(self, capacity: int = SMALL) -> None:
        self._least = capacity
        self._data = _NOTHING
        self._view = _NO_VIEW
        self._start = 0
        self._end = 0

    def __len__(self) -> int:
        return self._end - self._start

    @property
    def capacity(self) -> int:
        """How many bytes fit."""
        return len(self._data)

    def free(self) -> memoryview:
        """Return the free tail, never empty; valid until the next call of any method."""
        if self._data is _NOTHING:
            self._data = bytearray(self._least)
            self._view = memoryview(self._data)
        elif self._end == len(self._data):
            self._make_room(0 if self._start else 2 * len(self._data))
        return self._view[self._end :]

    def enlarge(self, size: int = OPEN) -> None:
        """Read more at a time from now on, by default because the peer is authenticated."""
        self._least = size

    def filled(self, count: int) -> None:
        """Note that `count` bytes were written at the start of the free tail."""
        self._end += count

    def unread(self) -> memoryview:
        """Return the bytes not consumed yet."""
        return self._view[self._start : self._end]

    def consume(self, count: int) -> None:
        """Drop `count` bytes from the front."""
        self._start += count
        if self._start < self._end:
            return
        self._start = self._end = 0
        if count <= self._least and len(self._data) <= _GIVE_BACK:
            self._data, self._view = _NOTHING, _NO_VIEW

    def expect(self, count: int, grow_to: int) -> None:
        """Move, or grow towards `grow_to`, as a frame of `count` bytes from the front has begun."""
        if self._start + count <= len(self._data):
            return
        if count <= len(self._data):
            self._make_room(0)
            return
        wanted, earned = max(count, grow_to), _EARNED * len(self)
        self._make_room(wanted if earned >= wanted else min(earned, count - 1))

    def clear(self) -> None:
        """Give all memory back; views that were handed out keep what they show."""
        self._data, self._view = _NOTHING, _NO_VIEW
        self._start = self._end = 0

    def _make_room(self, size: int) -> None:
        """Move what is unread to the front, of a buffer of at least `size` bytes."""
        unread, length = self.unread(), len(self)
        if size > len(self._data):
            self._data = bytearray(size)
            self._view = memoryview(self._data)
        self._view[:length] = unread
        self._start, self._end = 0, length
