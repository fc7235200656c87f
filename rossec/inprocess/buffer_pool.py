"""Reuses the memory of large messages once their bytes are no longer referenced.

New pages for a message cost the publisher about as much as encrypting it.
"""

from collections import deque
from contextlib import suppress
from io import BytesIO
from sys import getrefcount
from typing import Final

_UNUSED: Final = 2  # references: the buffer's, and the argument of `getrefcount`


class BufferPool:
    """The last `count` buffers whose bytes were handed out; threads share it."""

    def __init__(self, count: int) -> None:
        self._buffers: deque[BytesIO] = deque(maxlen=count)

    def exchange(self, buffer: BytesIO) -> BytesIO:
        """Keep `buffer`, and return one to write to from its start.

        The count of references affects speed only: a `BytesIO` never writes into bytes that are
        referenced elsewhere, it copies them first.
        """
        self._buffers.append(buffer)
        with suppress(IndexError):  # another thread took the last buffer
            for _ in range(len(self._buffers)):
                oldest = self._buffers.popleft()
                if getrefcount(oldest.getvalue()) == _UNUSED:
                    oldest.seek(0)
                    return oldest
                self._buffers.append(oldest)
        return BytesIO()
