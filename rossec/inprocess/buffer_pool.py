"""Memory of large messages, used again when nobody holds their bytes any more.

New pages for a message cost the publisher about as much as encrypting it.
"""

from collections import deque
from contextlib import suppress
from io import BytesIO
from sys import getrefcount
from typing import Final

_ITS_OWN: Final = 2  # references: the buffer's, and the argument of the question


class BufferPool:
    """The last `count` buffers whose bytes were handed out; threads share it."""

    def __init__(self, count: int) -> None:
        self._kept: deque[BytesIO] = deque(maxlen=count)

    def exchange(self, buffer: BytesIO) -> BytesIO:
        """Keep `buffer`, and return one to write to from its start.

        Only whether it pays depends on the count of references: a `BytesIO` never writes into
        bytes that somebody holds, it moves to a copy of its own first.
        """
        self._kept.append(buffer)
        with suppress(IndexError):  # another thread took the last
            for _ in range(len(self._kept)):
                oldest = self._kept.popleft()
                if getrefcount(oldest.getvalue()) == _ITS_OWN:
                    oldest.seek(0)
                    return oldest
                self._kept.append(oldest)
        return BytesIO()
