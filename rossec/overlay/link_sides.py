"""The two halves of a link, and its timing: what may be on the way, what is overdue. Pure.

A sent frame stays here, as it was sent, until it is acknowledged. It is lost when the peer saw what was
sent after it, and not it. So only what is missing is sent again, and a frame is never cut anew.
"""

from bisect import bisect_left
from collections import deque
from dataclasses import dataclass
from operator import itemgetter
from typing import Final

from rossec.channel.records import Bytes
from rossec.errors import LinkEnded
from rossec.overlay.link_frames import MAX_BODY, MAX_RANGES

FIRST_WINDOW: Final = 64 * 1024
LEAST_WINDOW: Final = 16 * 1024
MOST_WINDOW: Final = 4 * 1024 * 1024
STEP: Final = 64 * 1024
PROGRESS_TIMEOUT: Final = 30.0  # seconds without progress, after which a link is over
KEEPALIVE: Final = 5.0  # seconds without a frame of the peer, after which it is asked for one
LINGER: Final = 5.0  # seconds for the last acknowledgements of both ends
QUEUE: Final = 0.1  # seconds that bytes of this link may wait in queues
LEAST_WAIT: Final = 0.2  # seconds
MOST_WAIT: Final = 2.0
_SILENCE_PART: Final = 8  # the next try comes after an eighth of the silence so far
MOST_FRAMES: Final = 512  # on the way: small writes are joined meanwhile
_CUT: Final = 16 * 1024  # a smaller piece waits for room, rather than be cut for what there is
ACK_DELAY: Final = 0.005  # seconds: most answers leave within that, and acknowledge by themselves
_ACK_FRAMES: Final = 16
_ACK_BYTES: Final = 32 * 1024
_MOST_KEPT: Final = 512  # frames beyond a gap


class RoundTrip:
    """The smoothed and the shortest round trip, in seconds; 0 until one was measured."""

    def __init__(self) -> None:
        self.srtt_s = 0.0
        self.least_s = 0.0

    def sample(self, seconds: float) -> None:
        self.srtt_s = seconds if self.srtt_s == 0.0 else self.srtt_s + (seconds - self.srtt_s) / 8
        self.least_s = min(self.least_s or seconds, seconds)

    @property
    def queued_s(self) -> float:
        return self.srtt_s - self.least_s

    def way_changed(self) -> None:
        self.least_s = self.srtt_s

    @property
    def wait(self) -> float:
        # Asking early costs a small frame, and nothing is sent again for it: it follows the others.
        return max(LEAST_WAIT, min(MOST_WAIT, 4 * self.srtt_s))

    @property
    def repeat(self) -> float:
        # How long a frame that was sent again is not judged: what crossed it says nothing.
        return max(0.01, 1.25 * self.srtt_s)

    def again(self, silence: float) -> float:
        # How long until it is asked again, after so many seconds without an answer.
        # Doubling would sleep for seconds after a router's successor took over.
        return max(LEAST_WAIT, min(MOST_WAIT, max(2 * self.srtt_s, silence / _SILENCE_PART)))


class CongestionWindow:
    """How many bytes may be on the way (docs/spec/overlay.md section 3.5)."""

    def __init__(self) -> None:
        self.size = FIRST_WINDOW
        self._threshold = MOST_WINDOW
        self._recovery = 0
        self._delayed = 0  # bytes that arrived late since the window was shrunk

    def acknowledged(self, count: int, on_the_way: int, queued_s: float = 0.0) -> None:
        # So many bytes arrived, of so many that were on the way, after waiting in queues.
        # 1. The kernel and routers queue megabytes before they drop, behind which every other stream of the
        #    link would wait for seconds: a round trip that grew shrinks the window (LEDBAT, RFC 6817).
        if queued_s > QUEUE:
            self._delayed += count
            if self._delayed >= self.size:
                self._delayed = 0
                self.size = self._threshold = max(LEAST_WINDOW, self.size - self.size // 4)
            return
        # 2. A writer that is slower than the window says nothing about the line.
        if on_the_way < self.size // 2:
            return
        # 3. Doubled each round trip until something is lost, then by a step.
        if self.size >= self._threshold:
            count = min(count, STEP * count // self.size)
        self.size = min(MOST_WINDOW, self.size + count)

    def lost(self, offset: int, sent: int) -> None:
        # Routers drop what they cannot queue: halved once for all that was on the way then.
        if offset >= self._recovery:
            self._recovery = sent
            self.size = self._threshold = max(LEAST_WINDOW, self.size // 2)


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
        return bool(self._flight)

    @property
    def waiting(self) -> bool:
        return bool(self._flight or self._waiting)

    # -- what may be sent

    def room(self) -> int:
        if len(self._flight) >= MOST_FRAMES or self._losses:
            return 0
        return max(0, min(self.limit - self.next, self.window.size - self._on_the_way))

    def fits(self, size: int) -> bool:
        return not self._waiting and size <= MAX_BODY and size <= self.room()

    def queue(self, data: Bytes) -> None:
        # Keep a copy of what cannot be sent now.
        if data:
            self._waiting.append(bytes(data))
            self.backlog += len(data)

    def cut(self, most: int) -> list[Bytes]:
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
        end = self.next + size
        self._flight.append(Sent(self.next, end, frame, now))
        self.next = end
        self._on_the_way += size

    def repeat_first(self, now: float) -> bytes:
        first = self._flight[0]
        first.again, first.at = True, now
        self.retransmissions += 1
        return first.frame

    def resend(self, most: int, now: float) -> bytes | None:
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
        # Returns whether that is more than before.
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
        # Everything below `seen` that did not arrive is lost; `ranges` arrived beyond a gap.
        at = 0
        for sent in self._flight if ranges else ():
            while at < len(ranges) and ranges[at][1] < sent.end:
                at += 1
            if at == len(ranges):
                break
            if not sent.arrived and ranges[at][0] <= sent.offset:
                sent.arrived = True
                if not sent.lost:
                    self._on_the_way -= sent.end - sent.offset
        if len(ranges) == MAX_RANGES:  # what is beyond the last may have arrived: nobody says
            seen = min(seen, ranges[-1][1])
        # Routers keep the order of what they do not lose: what was passed by later frames is lost.
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

    def forget(self) -> None:
        for kept in (self._waiting, self._flight, self._losses):
            kept.clear()
        self.backlog = self._on_the_way = 0


class Receiver:
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
        self._window = MOST_WINDOW
        self.limit = self._consumed + MOST_WINDOW
        self.ack_at = now

    def data(self, offset: int, body: memoryview, now: float) -> list[Bytes]:
        end = offset + len(body)
        if end > self._told_limit:
            raise LinkEnded("the peer sent more than it was allowed")
        if self.ended and end > self.expected:
            raise LinkEnded("the peer sent more after its end")
        self.seen = max(self.seen, end)
        if offset == self.expected and not self._kept:
            self.expected = end
            # Acknowledge at once from so much on; what is less waits for an answer to go with.
            self._unacknowledged += 1
            self._unacknowledged_bytes += len(body)
            if self._unacknowledged >= _ACK_FRAMES or self._unacknowledged_bytes >= _ACK_BYTES:
                self.ack_at = now
            elif self.ack_at is None:
                self.ack_at = now + ACK_DELAY
            return [body]
        self._ask(now)
        if offset > self.expected:
            self._keep(offset, end, body)
            return []
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

    def _ask(self, now: float) -> None:
        self._asked, self.ack_at = True, now

    def _keep(self, offset: int, end: int, body: memoryview) -> None:
        kept = self._kept
        # 3.3: nothing is kept for a peer that is not authenticated; 3.4: nor more than so many frames.
        if self._window == FIRST_WINDOW or len(kept) >= _MOST_KEPT:
            return
        at = bisect_left(kept, offset, key=itemgetter(0))
        before = at > 0 and kept[at - 1][0] + len(kept[at - 1][1]) > offset
        after = at < len(kept) and kept[at][0] < end
        if not (before or after):
            kept.insert(at, (offset, body))

    def end(self, offset: int, now: float) -> None:
        # The peer's stream ends at `offset`; noted only when all before it is here.
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
        self.seen = max(self.seen, min(offset, self._told_limit + 1))
        self._ask(now)

    def consumed(self, count: int, now: float) -> None:
        # The limit moves with what the application took, so a slow one closes it.
        self._consumed += count
        if self._consumed > self.expected:
            raise ValueError("more was consumed than was received")
        self.limit = self._consumed + self._window
        if self.limit - self._told_limit >= self._window // 4:
            self.ack_at = now

    def ranges(self) -> list[tuple[int, int]]:
        found: list[tuple[int, int]] = []
        for first, piece in self._kept:
            end = first + len(piece)
            if found and found[-1][1] == first:
                found[-1] = (found[-1][0], end)
            else:
                found.append((first, end))
        return found

    def told(self, *, ack: bool = False) -> None:
        self._told_limit = self.limit
        self._unacknowledged = self._unacknowledged_bytes = 0
        if ack or not self._asked:
            self._asked, self.ack_at = False, None

    def forget(self) -> None:
        self._kept.clear()
        self.ack_at = None
