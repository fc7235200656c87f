"""The receiving half of a link: bytes in order, and what the peer is told of them. Pure.

What comes beyond a gap is kept, within the limit that the peer was told, and only from a peer that
is authenticated. The limit moves with what the application took, so a slow one closes it.
"""

from bisect import bisect_left
from typing import Final

from rossec.channel.records import Bytes
from rossec.errors import LinkEnded
from rossec.overlay.link_timing import FIRST_WINDOW, MOST_WINDOW

ACK_DELAY: Final = 0.005  # seconds: most answers leave within that, and acknowledge by themselves
_ACK_FRAMES: Final = 16
_ACK_BYTES: Final = 32 * 1024
_MOST_KEPT: Final = 512  # frames beyond a gap


class Receiver:
    """Bytes received, in order."""

    __slots__ = (
        "_asked", "_consumed", "_kept", "_told_limit", "_unacknowledged", "_unacknowledged_bytes",
        "_window", "ack_at", "ended", "expected", "limit", "seen",
    )  # fmt: skip

    def __init__(self) -> None:
        self._kept: list[tuple[int, memoryview]] = []  # by offset, without overlaps
        self._consumed = 0
        self._window = FIRST_WINDOW
        self._unacknowledged = self._unacknowledged_bytes = 0
        self.expected = 0
        self.limit = self._told_limit = FIRST_WINDOW
        self.seen = 0
        self.ended = False
        self._asked = False  # only an ACK answers: there is a gap, or the peer asked
        self.ack_at: float | None = None  # when to acknowledge at the latest

    def widen(self, now: float) -> None:
        """The peer is authenticated: it may send as much as a link may hold."""
        self._window = MOST_WINDOW
        self.limit = self._consumed + MOST_WINDOW
        self.ack_at = now

    def data(self, offset: int, body: memoryview, now: float) -> list[Bytes]:
        """Take bytes of the stream; returns what is now in order.

        Raises:
            LinkEnded: beyond the limit that was told, or after the end.
        """
        end = offset + len(body)
        if end > self._told_limit:
            raise LinkEnded("the peer sent more than it was allowed")
        if self.ended and end > self.expected:
            raise LinkEnded("the peer sent more after its end")
        self.seen = max(self.seen, end)
        if offset == self.expected and not self._kept:
            self.expected = end
            self._count(len(body), now)
            return [body]
        self._ask(now)
        if offset > self.expected:
            self._keep(offset, end, body)
            return []
        return self._deliver(offset, body)

    def _ask(self, now: float) -> None:
        self._asked, self.ack_at = True, now

    def _count(self, size: int, now: float) -> None:
        """Acknowledge at once from so much on; what is less waits for an answer to go with."""
        self._unacknowledged += 1
        self._unacknowledged_bytes += size
        if self._unacknowledged >= _ACK_FRAMES or self._unacknowledged_bytes >= _ACK_BYTES:
            self.ack_at = now
        elif self.ack_at is None:
            self.ack_at = now + ACK_DELAY

    def _keep(self, offset: int, end: int, body: memoryview) -> None:
        kept = self._kept
        if self._window == FIRST_WINDOW or len(kept) >= _MOST_KEPT:
            return
        at = bisect_left(kept, offset, key=_first)
        before = at > 0 and kept[at - 1][0] + len(kept[at - 1][1]) > offset
        after = at < len(kept) and kept[at][0] < end
        if not (before or after):
            kept.insert(at, (offset, body))

    def _deliver(self, offset: int, body: memoryview) -> list[Bytes]:
        """What closes a gap, with what was kept behind it."""
        found: list[Bytes] = []
        used = 0
        for first, piece in [(offset, body), *self._kept]:
            if first > self.expected:
                break
            used += 1
            new = piece[self.expected - first :]
            if new:
                found.append(new)
                self.expected += len(new)
        del self._kept[: max(0, used - 1)]
        return found

    def end(self, offset: int, now: float) -> None:
        """The peer's stream ends at `offset`; noted only when all before it is here.

        Raises:
            LinkEnded: there was more, or another end.
        """
        self._ask(now)
        if self.ended:
            if offset + 1 != self.expected:
                raise LinkEnded("the peer ended its stream twice")
            return
        last = self._kept[-1] if self._kept else (self.expected, memoryview(b""))
        if offset < last[0] + len(last[1]):
            raise LinkEnded("the peer ended its stream before its end")
        self.seen = max(self.seen, offset + 1)
        if offset == self.expected:
            self.expected += 1
            self.ended = True

    def probed(self, offset: int, now: float) -> None:
        """The peer sent up to `offset` and asks what came."""
        self.seen = max(self.seen, min(offset, self._told_limit + 1))
        self._ask(now)

    def consumed(self, count: int, now: float) -> None:
        """The application took so many bytes."""
        self._consumed += count
        if self._consumed > self.expected:
            raise ValueError("more was consumed than was received")
        self.limit = self._consumed + self._window
        if self.limit - self._told_limit >= self._window // 4:
            self.ack_at = now

    def ranges(self) -> list[tuple[int, int]]:
        """What is kept beyond the first gap: (first, end)."""
        found: list[tuple[int, int]] = []
        for first, piece in self._kept:
            end = first + len(piece)
            if found and found[-1][1] == first:
                found[-1] = (found[-1][0], end)
            else:
                found.append((first, end))
        return found

    def told(self, *, ack: bool = False) -> None:
        """A frame leaves, and says how far this side is; an ACK, also what it saw."""
        self._told_limit = self.limit
        self._unacknowledged = self._unacknowledged_bytes = 0
        if ack or not self._asked:
            self._asked, self.ack_at = False, None

    def forget(self) -> None:
        """Keep nothing: the link ended."""
        self._kept.clear()
        self.ack_at = None


def _first(entry: tuple[int, memoryview]) -> int:
    return entry[0]
