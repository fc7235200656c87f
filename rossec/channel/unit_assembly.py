"""The unit that is being received: records verified one by one, handed out as a whole.

Nothing of it is handed out before its last record has verified, and it grows only as authenticated
bytes arrive, up to a limit that is checked before a record is.
"""

from collections import deque
from io import SEEK_END, BytesIO
from sys import getrefcount
from typing import Final

from rossec.channel.records import TAG, Direction, unpadded
from rossec.errors import LimitExceeded

_ITS_OWN: Final = 2  # references: the buffer's, and the argument of `getrefcount`
_KEEP: Final = 16 * 1024 * 1024  # memory of larger units is given back at once


class UnitAssembly:
    """The unit being received, handed out only when its last record has verified.

    `BytesIO` because it gives a writable view to decrypt into, and then the very same memory as
    `bytes`, without a copy. It grows only as authenticated bytes arrive. Memory that the reader of
    a unit has released is reused: new pages cost about as much as decrypting into them.
    """

    __slots__ = ("_buffer", "_handed_out", "_last", "_room", "length", "limit")

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self._buffer = BytesIO()
        self._handed_out: deque[BytesIO] = deque(maxlen=2)  # the next unit comes before one is read
        self._room = 0
        self._last = 0  # size of the last unit: the next one is likely to be as large
        self.length = 0

    def add(self, direction: Direction, head: bytes, body: memoryview) -> None:
        """Verify a record and append it.

        Raises:
            RecordForged: it does not verify.
            LimitExceeded: the unit is longer than allowed.
        """
        end = self.check_room(len(body))
        if self.length == 0:
            self._begin()
        if end > self._room:
            self._grow(end)
        with self._buffer.getbuffer() as view, view[self.length : end] as target:
            direction.open_into(head, body, target)
        self.length = end

    def finish(self, direction: Direction, head: bytes, body: memoryview) -> bytes:
        """Verify the last record of the unit and return the unit.

        Raises:
            RecordForged, LimitExceeded: as for `add`.
        """
        if self.length == 0:
            self.check_room(len(body))
            return direction.open(head, body)
        self.add(direction, head, body)
        return self._finished()

    def finish_padded(self, direction: Direction, head: bytes, body: memoryview) -> bytes:
        """As `finish`, for a record with padding behind its data.

        Raises:
            RecordForged, LimitExceeded: as for `add`.
            ProtocolViolation: nothing says where the data ends, or there is none.
        """
        self.check_room(len(body))
        last = unpadded(direction.open(head, body))
        if self.length == 0:
            return last
        end = self.length + len(last)
        if end > self._room:
            self._grow(end)
        with self._buffer.getbuffer() as view:
            view[self.length : end] = last
        self.length = end
        return self._finished()

    def _finished(self) -> bytes:
        self._buffer.truncate(self.length)
        unit = self._buffer.getvalue()
        if self.length <= _KEEP:
            self._handed_out.append(self._buffer)
        self._last, self.length = self.length, 0
        return unit

    def discard(self) -> None:
        """Drop an incomplete unit, and memory that is kept for the next one."""
        self._buffer = BytesIO()
        self._handed_out.clear()
        self._room = self.length = 0

    def check_room(self, body: int) -> int:
        """How long the unit is with a record whose sealed body has `body` bytes.

        Raises:
            LimitExceeded: longer than allowed.
        """
        end = self.length + body - TAG
        if end > self.limit:
            raise LimitExceeded(f"the peer sends a unit of more than {self.limit} bytes")
        return end

    def _begin(self) -> None:
        self._buffer, self._room = BytesIO(), 0
        # Only whether it pays depends on the count: a `BytesIO` never writes into bytes that
        # are referenced elsewhere, it moves to a copy of its own first.
        if self._handed_out and getrefcount(self._handed_out[0].getvalue()) == _ITS_OWN:
            self._buffer = self._handed_out.popleft()
            self._room = self._buffer.seek(0, SEEK_END)

    def _grow(self, needed: int) -> None:
        self._room = min(self.limit, max(needed, 2 * self.length, self._last))
        self._buffer.seek(self._room - 1)
        self._buffer.write(b"\0")
