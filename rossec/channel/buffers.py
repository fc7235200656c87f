"""The receive buffer: the socket writes into it, frames are parsed and decrypted from it in place.

Bytes are moved only when an incomplete frame has reached the end of the buffer. It grows when a
frame's header, already checked against the limits, says that the frame will not fit. An idle
connection has none: an empty buffer is freed, but not one for large frames while many of them
arrive.
"""

from typing import Final

SMALL: Final = 2 * 1024
"""Before authentication; an unknown peer costs no more until its frames are plausible."""
OPEN: Final = 8 * 1024
"""After it: several small records fit."""


_GIVE_BACK: Final = 64 * 1024  # larger buffers are kept: allocating them again costs too much
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
            self.reserve(len(self) + 1)
        return self._view[self._end :]

    def enlarge(self) -> None:
        """Read more at a time from now on: the peer is authenticated."""
        self._least = OPEN

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

    def reserve(self, count: int, grow_to: int = 0) -> None:
        """Make room so that `count` bytes from the front fit, by moving or by growing."""
        if self._start + count <= len(self._data):
            return
        unread, length = self.unread(), len(self)
        if count > len(self._data):
            self._data = bytearray(max(count, grow_to, 2 * len(self._data), self._least))
            self._view = memoryview(self._data)
        self._view[:length] = unread
        self._start, self._end = 0, length
