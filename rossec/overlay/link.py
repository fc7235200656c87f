"""One link: a reliable stream of bytes each way over a carrier that may lose frames. Pure.

`now` is a monotonic clock in seconds. After every call: put what `frames_to_send` returns, and
call `tick` at `deadline`. Nothing here is authenticated: the bytes inside are. So routers, who see the
identifier of a link, can end it, as they could by dropping. Numbers are sections of docs/spec/overlay.md.
"""

from enum import IntEnum, auto
from typing import Final, NamedTuple, Self

from rossec.channel.records import Bytes
from rossec.errors import LinkEnded
from rossec.overlay import link_frames as frames
from rossec.overlay.link_frames import HEAD, MAX_FRAME, OPEN_SIZE, LinkFrame, LinkFrameKind
from rossec.overlay.link_sides import FIRST_WINDOW, KEEPALIVE, LINGER, PROGRESS_TIMEOUT, Receiver, Sender

AMPLIFICATION: Final = 3
_HIGH_WATER: Final = 64 * 1024  # bytes not sent yet, above which a writer should wait


class LinkState(IntEnum):
    IDLE = auto()  # called from here, and nothing written yet
    OPENING = auto()  # OPEN was sent
    RUNNING = auto()
    DRAINING = auto()  # `finish` was called
    DONE = auto()  # both sides ended
    RESET = auto()


ENDED: Final = frozenset({LinkState.DONE, LinkState.RESET})
OPEN: Final = frozenset({LinkState.RUNNING, LinkState.DRAINING})
NEXT: Final = {
    (LinkState.IDLE, "write"): LinkState.OPENING,
    (LinkState.IDLE, "finish"): LinkState.DONE,
    (LinkState.OPENING, "answer"): LinkState.RUNNING,
    (LinkState.RUNNING, "finish"): LinkState.DRAINING,
    (LinkState.DRAINING, "drained"): LinkState.DONE,
}
"""What changes a state; a reset ends every one, and the rest changes none."""


class LinkStats(NamedTuple):
    """What a link measured: round trips (smoothed, least; 0: none yet), octets of its streams."""

    srtt_s: float
    retransmissions: int
    sent: int
    received: int
    least_s: float = 0.0


class Link:
    def __init__(self, link_id: bytes, reply_key: str, now: float, *, opener: bool) -> None:
        if len(link_id) != frames.LINK_ID:
            raise ValueError(f"a link identifier has {frames.LINK_ID} bytes")
        self.link_id, self.reply_key = link_id, reply_key
        self.state = LinkState.IDLE if opener else LinkState.RUNNING
        self._opener = opener
        self._validated = False
        self._octets_in = self._octets_out = 0
        self._out: list[bytes] = []
        self._sender = Sender()
        self._receiver = Receiver()
        self._began = now
        self.silent_since: float | None = None  # since when an answer is missing
        self._probe_at: float | None = None
        self._end_offset: int | None = None  # of this side's END, when it was sent
        self._end_at: float | None = None  # when the last acknowledgements are given up

    @classmethod
    def open(cls, link_id: bytes, reply_key: str, now: float) -> Self:
        return cls(link_id, reply_key, now, opener=True)

    @classmethod
    def accept(cls, frame: bytes, now: float) -> Self:
        opened = frames.read(frame)
        if opened.kind != LinkFrameKind.OPEN or opened.offset != 0 or opened.received != 0:
            raise LinkEnded("a link that does not begin with its OPEN")
        reply_key, _ = frames.split_return_address(opened.body)
        return cls(opened.link, reply_key, now, opener=False)

    # -- receiving

    def receive(self, frame: bytes, now: float) -> list[Bytes]:
        if self.state in ENDED:
            return []
        try:
            # 3.1: what is not in form ends the link. 3.3: what is in form pays for three times as much.
            read = frames.read(frame)
            self._octets_in += len(frame)
            return self._take(read, now)
        except LinkEnded:
            told = frame[:1] == bytes((LinkFrameKind.RESET,))  # a reset is not answered
            last = self.reset()
            self._out = [] if told else [last]
            raise

    def _take(self, frame: LinkFrame, now: float) -> list[Bytes]:
        # 3.2: does it belong here, and what does it do to the state?
        kind = frame.kind
        if frame.link != self.link_id:
            raise LinkEnded("a frame of another link")
        if kind == LinkFrameKind.RESET:
            raise LinkEnded("the other side reset the link")
        if self.state is LinkState.IDLE:
            raise LinkEnded("an answer to a link that was not opened")
        if self.state is LinkState.OPENING:
            self._move("answer")
        # 3.5: its head, which every kind has: how far this side's bytes came, and may go.
        progress = self._sender.received(frame.received, frame.limit, now)
        # 3.4: its own part.
        found: list[Bytes] = []
        if kind == LinkFrameKind.DATA:
            found = self._receiver.data(frame.offset, frame.body, now)
        elif kind == LinkFrameKind.ACK:
            self._sender.seen(frame.offset, frames.read_ranges(frame), now)
        elif kind == LinkFrameKind.OPEN:
            reply_key, body = frames.split_return_address(frame.body)
            if self._opener or frame.offset != 0 or reply_key != self.reply_key:
                raise LinkEnded("another OPEN for a link that is open")
            found = self._receiver.data(0, body, now)
        elif kind == LinkFrameKind.PROBE:
            self._receiver.probed(frame.offset, now)
        else:
            self._receiver.end(frame.offset, now)
        self._settle(progress, now)
        return found

    def consumed(self, count: int, now: float) -> None:
        if self.state not in ENDED:
            self._receiver.consumed(count, now)

    @property
    def peer_ended(self) -> bool:
        return self._receiver.ended

    # -- sending

    def write(self, data: Bytes, now: float) -> None:
        # Send `data`, which may change afterwards, as soon as may be; after the end, never.
        size = len(data)
        if size == 0:
            return
        if self.state is LinkState.IDLE:
            address = frames.return_address(self.reply_key, OPEN_SIZE - HEAD - len(data))
            first = memoryview(data)[:FIRST_WINDOW]
            self._move("write")
            self._began = now
            self._transmit(LinkFrameKind.OPEN, [address, first], len(first), now)
            self._sender.queue(memoryview(data)[FIRST_WINDOW:])
        elif self.state is LinkState.RUNNING:
            if self._sender.fits(size) and HEAD + size <= self._allowance():
                self._transmit(LinkFrameKind.DATA, [data], size, now)
            else:
                self._sender.queue(data)
        elif self.state is LinkState.OPENING:
            self._sender.queue(data)

    def _transmit(self, kind: LinkFrameKind, pieces: list[Bytes], size: int, now: float) -> None:
        sender = self._sender
        frame = frames.joined(self._head(kind, sender.next), pieces)
        sender.sent(frame, size, now)
        self._put(frame)
        if self.silent_since is None:
            self.silent_since = now
            self._probe_at = now + sender.round_trip.wait

    def _head(self, kind: LinkFrameKind, offset: int) -> bytes:
        receiver = self._receiver
        receiver.told(ack=kind is LinkFrameKind.ACK)
        return frames.head(kind, self.link_id, offset, receiver.expected, receiver.limit)

    def _put(self, frame: bytes) -> None:
        self._octets_out += len(frame)
        self._out.append(frame)

    def _allowance(self) -> int:
        # 3.3: the reply inbox may be forged: until the peer is authenticated it must not amplify.
        if self._validated or self._opener:
            return MAX_FRAME
        return AMPLIFICATION * self._octets_in - self._octets_out - HEAD

    @property
    def writable(self) -> bool:
        return self._sender.backlog <= _HIGH_WATER

    @property
    def backlog(self) -> int:
        return self._sender.backlog

    def frames_to_send(self, now: float) -> list[bytes]:
        if self.state not in ENDED:
            self._pump(now)
            self._acknowledge(now)
        out, self._out = self._out, []
        return out

    def _pump(self, now: float) -> None:
        # 3.5: what was lost goes again before anything new; 3.2: in OPENING nothing but the OPEN.
        sender = self._sender
        while (frame := sender.resend(self._allowance(), now)) is not None:
            self._put(frame)
        if self.state not in OPEN:
            return
        while sender.backlog:
            pieces = sender.cut(self._allowance() - HEAD)
            if not pieces:
                return
            self._transmit(LinkFrameKind.DATA, pieces, sum(map(len, pieces)), now)
        # 3.1: END counts as one byte, and needs no leave of `limit`.
        draining = self.state is LinkState.DRAINING and self._end_offset is None
        if draining and self._allowance() >= HEAD:
            self._end_offset = sender.next
            self._transmit(LinkFrameKind.END, [], 1, now)

    def _acknowledge(self, now: float) -> None:
        receiver = self._receiver
        if receiver.ack_at is None or receiver.ack_at > now:
            return
        # 3.4: what came beyond a gap is announced, or the peer would send all of it again.
        body = frames.pack_ranges(receiver.ranges())
        if HEAD + len(body) <= self._allowance():
            self._put(self._head(LinkFrameKind.ACK, max(receiver.seen, receiver.expected)) + body)
        else:
            receiver.told(ack=True)  # the peer asks again

    # -- ends

    def validated(self) -> None:
        # Both sides call it; a side that never does is over after `PROGRESS_TIMEOUT`.
        if not self._validated and self.state not in ENDED:
            self._validated = True
            self._receiver.widen(self._began)

    def finish(self, now: float) -> None:
        if self.state is LinkState.OPENING:
            self._out = [self.reset()]  # nobody answered: nothing is to be drained
        elif (self.state, "finish") in NEXT:
            self._move("finish")
            self._pump(now)

    def reset(self) -> bytes:
        # End the link at once; returns the frame that says so.
        frame = frames.head(LinkFrameKind.RESET, self.link_id, 0, self._receiver.expected, 0)
        self._over(LinkState.RESET)
        self._out = []
        return frame

    def _move(self, event: str) -> None:
        state = NEXT[self.state, event]
        if state in ENDED:
            self._over(state)
        else:
            self.state = state

    def _over(self, state: LinkState) -> None:
        self.state = state
        self._sender.forget()
        self._receiver.forget()
        self._probe_at = self._end_at = self.silent_since = None

    # -- time

    def _settle(self, progress: bool, now: float) -> None:
        # After a frame of the peer: is all said, and until when must it answer again?
        sender = self._sender
        if self._end_offset is not None and sender.base >= self._end_offset:
            # 3.2: all before END is acknowledged: the five seconds begin, unless both sides are done.
            if self._receiver.ended and not sender.in_flight:
                self._acknowledge(now)
                self._move("drained")
                return
            if self._end_at is None:
                self._end_at = now + LINGER
        # 3.5: progress is that more arrived there, or any frame while nothing is to be acknowledged.
        if sender.in_flight and not progress:
            return
        self.silent_since = now if sender.in_flight else None
        asks = sender.waiting or (self._opener and not self._validated)
        self._probe_at = now + (sender.round_trip.wait if asks else KEEPALIVE)

    def deadline(self) -> float | None:
        if self.state in ENDED:
            return None
        times = (self._over_at(), self._probe_at, self._receiver.ack_at, self._end_at)
        return min((at for at in times if at is not None), default=None)

    def _over_at(self) -> float | None:
        # 3.3: a link whose peer is not authenticated has so long in all, whatever it sends meanwhile.
        since = self.silent_since
        if not self._validated and (since is None or self._began < since):
            since = self._began
        return None if since is None or self.state is LinkState.IDLE else since + PROGRESS_TIMEOUT

    def tick(self, now: float) -> None:
        if self.state in ENDED:
            return
        over = self._over_at()
        if over is not None and now >= over:
            self._out = [self.reset()]
            raise LinkEnded(
                f"no progress on a link for {PROGRESS_TIMEOUT:.0f} s",
                "is the other relay running, and is a router reached from both?",
            )
        if self._end_at is not None and now >= self._end_at:
            self._move("drained")
        elif self._probe_at is not None and now >= self._probe_at:
            # 3.5: the peer is asked, in OPENING with the OPEN.
            if self.silent_since is None:
                self.silent_since = now
            self._probe_at = now + self._sender.round_trip.again(now - self.silent_since)
            if self.state is LinkState.OPENING:
                self._put(self._sender.repeat_first(now))
                return
            body = b""
            if self._opener:  # a relay that was started again learns where to refuse
                # 3.3: padded until the handshake is complete: it pays for a long answer.
                padded = 0 if self._validated else OPEN_SIZE - HEAD
                body = frames.return_address(self.reply_key, padded)
            if HEAD + len(body) <= self._allowance():
                self._put(self._head(LinkFrameKind.PROBE, self._sender.next) + body)

    # -- measured

    @property
    def stats(self) -> LinkStats:
        sender = self._sender
        trip, received = sender.round_trip, self._receiver.expected
        return LinkStats(trip.srtt_s, sender.retransmissions, sender.next, received, trip.least_s)
