"""Where a message of HTTP ends: bytes in, heads and bodies out, one message at a time. Sans-IO.

A length is checked before a byte of the body is kept. What the two sides make of a head: `http`.
"""

from dataclasses import dataclass
from typing import Final

from rossec.errors import HttpRefused

HEADERS_LIMIT: Final = 8 * 1024
DROP_LIMIT: Final = 64 * 1024 * 1024
"""Bytes of a body that are read although it is too long, only to answer so."""
END: Final = b"\r\n\r\n"


@dataclass(frozen=True)
class Oversized:
    """Takes the place of a body that was longer than the limit, and is not kept.

    It is read to its end: a client that still writes would not read an answer, and roscpp repeats
    a call without one for ever.
    """

    length: int


class Reader:
    """Bytes in, whole messages out, one at a time."""

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self._data = b""
        self._rest: list[bytes] = []
        self._rest_size = 0  # of the pieces, none of which is empty
        self._begin = 0  # of the body, once the head is known
        self._end = 0
        self._dropped = 0  # bytes of a body that is too long
        self._left = 0  # and how many are still to come

    @property
    def pending(self) -> bool:
        """Whether a message has begun and was not taken."""
        return bool(self._data or self._rest or self._left)

    @property
    def in_body(self) -> bool:
        """Whether the head of a message is known, and its body was not taken."""
        return self._begin > 0 or self._dropped > 0

    def feed(self, data: bytes) -> None:
        """Take bytes from the peer."""
        if self._left and data:
            taken = min(self._left, len(data))
            self._left -= taken
            data = data[taken:]
        if data:
            self._rest.append(data)
            self._rest_size += len(data)

    def head(self) -> bytes | None:
        """The head without its end, or None while it is not complete."""
        self._join()
        found = self._data.find(END, 0, HEADERS_LIMIT + len(END))
        if found < 0:
            if self._data and not b"A" <= self._data[:1] <= b"Z":
                raise HttpRefused("malformed HTTP")
            if len(self._data) > HEADERS_LIMIT:
                raise HttpRefused("HTTP headers that are too long", status=431)
            return None
        return self._data[:found]

    def expect(self, head: bytes, length: int) -> None:
        """Expect a body of `length` bytes after `head`."""
        if length > self.limit:
            raise HttpRefused(f"an HTTP body longer than {self.limit} bytes", status=413)
        self._begin = len(head) + len(END)
        self._end = self._begin + length

    def drop(self, head: bytes, length: int) -> None:
        """Expect a body of `length` bytes after `head`, and keep none of them."""
        if length > DROP_LIMIT:
            raise HttpRefused(f"an HTTP body longer than {self.limit} bytes", status=413)
        rest = self._data[len(head) + len(END) :]
        self._data, self._dropped, self._left = b"", length, length
        self.feed(rest)

    def body(self) -> bytes | Oversized | None:
        """The body, or None while it is not complete."""
        if self._dropped:
            if self._left:
                return None
            dropped, self._dropped = Oversized(self._dropped), 0
            return dropped
        if len(self._data) + self._rest_size < self._end:
            return None
        self._join()
        body = self._data[self._begin : self._end]
        self.skip(self._end)
        return body

    def rest(self, begin: int) -> bytes:
        """All that arrived after `begin`, which is taken with what precedes it."""
        rest, self._data = self._data[begin:], b""
        return rest

    def skip(self, count: int) -> None:
        """Forget the first bytes, a message."""
        self._data = self._data[count:]
        self._begin = self._end = 0

    def _join(self) -> None:
        if self._rest:
            self._data = b"".join((self._data, *self._rest))
            self._rest, self._rest_size = [], 0
