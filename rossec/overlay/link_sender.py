"""The sending half of a link: what waits, what is on the way, what was lost. Pure.

A frame stays here, as it was sent, until it is acknowledged. It is lost when the peer saw what was
sent after it, and not it: routers keep the order. So only what is missing is sent again, and a
frame is never cut anew. Nothing passes the limit that the peer told, and the congestion window.
"""

from collections import deque
from dataclasses import dataclass
from typing import Final

from rossec.channel.records import Bytes
from rossec.errors import LinkEnded
from rossec.overlay.link_frames import MAX_BODY, MAX_RANGES
from rossec.overlay.link_timing import FIRST_WINDOW, LEAST_WINDOW, CongestionWindow, RoundTrip

MOST_FRAMES: Final = 512  # on the way: small writes are joined meanwhile
_CUT: Final = 16 * 1024  # a smaller piece waits for room, rather than be cut for what there is


@dataclass(slots=True)
class Sent:
    """A frame on the way: bytes [offset, end) of the stream."""

    offset: int
    end: int
    frame: bytes
    at: float
    lost: bool = False
    arrived: bool = False  # beyond a gap
    again: bool = False  # it was sent more than once


class Sender:
    """Bytes to send, in order."""

    __slots__ = (
        "_flight", "_losses", "_on_the_way", "_waiting", "backlog", "base", "limit",
        "next", "retransmissions", "round_trip", "window",
    )  # fmt: skip

    def __init__(self) -> None:
        self._waiting: deque[Bytes] = deque()
        self._flight: deque[Sent] = deque()
        self._losses: deque[Sent] = deque()
        self._on_the_way = 0  # bytes, without those that are lost or arrived beyond a gap
        self.backlog = 0  # bytes that were written and not sent yet
        self.base = self.next = 0
        self.limit = FIRST_WINDOW
        self.retransmissions = 0
        self.round_trip = RoundTrip()
        self.window = CongestionWindow()

    @property
    def in_flight(self) -> bool:
        """Whether something is not acknowledged."""
        return bool(self._flight)

    @property
    def waiting(self) -> bool:
        """Whether an answer of the peer is needed to go on."""
        return bool(self._flight or self._waiting)

    # -- what may be sent

    def room(self) -> int:
        """How many bytes may be sent now that were not sent yet."""
        if len(self._flight) >= MOST_FRAMES or self._losses:
            return 0
        return max(0, min(self.limit - self.next, self.window.size - self._on_the_way))

    def fits(self, size: int) -> bool:
        """Whether `size` bytes can be sent at once, as one frame and before nothing else."""
        return not self._waiting and size <= MAX_BODY and size <= self.room()

    def queue(self, data: Bytes) -> None:
        """Keep a copy of what cannot be sent now."""
        if data:
            self._waiting.append(bytes(data))
            self.backlog += len(data)

    def cut(self, most: int) -> list[Bytes]:
        """Take the pieces of the next body, at most `most` bytes; empty: nothing may be sent."""
        room = min(self.room(), most, MAX_BODY)
        whole = min(self.backlog, MAX_BODY)
        if room < whole and room < _CUT and self._flight:
            return []
        pieces: list[Bytes] = []
        while self._waiting and room > 0:
            piece = self._waiting.popleft()
            if len(piece) > room:
                view = memoryview(piece)
                self._waiting.appendleft(view[room:])
                piece = view[:room]
            pieces.append(piece)
            room -= len(piece)
            self.backlog -= len(piece)
        return pieces

    def sent(self, frame: bytes, size: int, now: float) -> None:
        """Note a frame with the next `size` bytes of the stream."""
        end = self.next + size
        self._flight.append(Sent(self.next, end, frame, now))
        self.next = end
        self._on_the_way += size

    def repeat_first(self, now: float) -> bytes:
        """The first frame on the way once more, whatever became of it."""
        first = self._flight[0]
        first.again, first.at = True, now
        self.retransmissions += 1
        return first.frame

    def resend(self, most: int, now: float) -> bytes | None:
        """The next lost frame, if it may be sent and has at most `most` octets."""
        while self._losses:
            sent = self._losses[0]
            size = sent.end - sent.offset
            if sent.end <= self.base or sent.arrived:
                self._losses.popleft()
                continue
            if len(sent.frame) > most:
                return None
            if self._on_the_way and self._on_the_way + size > self.window.size:
                return None
            self._losses.popleft()
            sent.lost, sent.again, sent.at = False, True, now
            self._on_the_way += size
            self.retransmissions += 1
            return sent.frame
        return None

    # -- what the peer says

    def received(self, received: int, limit: int, now: float) -> bool:
        """The peer received all bytes below `received`, and takes those below `limit`.

        Returns whether that is more than before.

        Raises:
            LinkEnded: more than was sent.
        """
        self.limit = max(self.limit, limit)
        if received <= self.base:
            return False
        if received > self.next:
            raise LinkEnded("the peer acknowledges what was not sent")
        before, flight = self._on_the_way, self._flight
        newest: Sent | None = None
        while flight and flight[0].end <= received:
            newest = flight.popleft()
            if not (newest.lost or newest.arrived):
                self._on_the_way -= newest.end - newest.offset
        if newest is not None and not newest.again:
            self.round_trip.sample(max(0.0, now - newest.at))
        self.window.acknowledged(received - self.base, before, self.round_trip.queued_s)
        if self.window.size == LEAST_WINDOW:  # it cannot be this link that fills the queues
            self.round_trip.way_changed()
        self.base = received
        return True

    def seen(self, seen: int, ranges: list[tuple[int, int]], now: float) -> None:
        """Everything below `seen` that did not arrive is lost; `ranges` arrived beyond a gap."""
        if ranges:
            self._mark_arrived(ranges)
        if len(ranges) == MAX_RANGES:  # what is beyond the last may have arrived: nobody says
            seen = min(seen, ranges[-1][1])
        repeat = self.round_trip.repeat
        for sent in self._flight:
            if sent.end > seen:
                break
            if sent.lost or sent.arrived or (sent.again and now - sent.at < repeat):
                continue
            sent.lost = True
            self._on_the_way -= sent.end - sent.offset
            self._losses.append(sent)
            self.window.lost(sent.offset, self.next)

    def _mark_arrived(self, ranges: list[tuple[int, int]]) -> None:
        at = 0
        for sent in self._flight:
            while at < len(ranges) and ranges[at][1] < sent.end:
                at += 1
            if at == len(ranges):
                return
            if not sent.arrived and ranges[at][0] <= sent.offset:
                sent.arrived = True
                if not sent.lost:
                    self._on_the_way -= sent.end - sent.offset

    def forget(self) -> None:
        """Keep nothing: the link ended."""
        for kept in (self._waiting, self._flight, self._losses):
            kept.clear()
        self.backlog = self._on_the_way = 0
