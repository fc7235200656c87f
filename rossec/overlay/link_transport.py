"""A link as the transport of a secure stream: `net.aio.transport.Transport`, without a socket.

What the owner does not read is not told to the link as consumed, so its window closes and the peer
waits, as a kernel's would. An end is the link's END, an abort its RESET. When nothing at all came
from the routers for a while, though an answer is due, the session with them is at fault: it is
replaced before the link gives up.
"""

import asyncio
from collections import deque
from collections.abc import Callable
from typing import Final

from rossec.channel.records import Bytes
from rossec.errors import LinkEnded
from rossec.net.aio.base import BaseStream
from rossec.net.aio.transport import TransportOwner
from rossec.overlay.carriers import FrameCarrier
from rossec.overlay.link import Link
from rossec.overlay.link_states import ENDED, LinkStats

STALLED: Final = 15.0  # seconds: half of what a link endures


class LinkTransport:
    """The link of one connection; it starts when its owner first writes.

    Args:
        link: opened or accepted.
        key: the mailbox of the peer.
        carrier: takes the frames.
        on_closed: called once, when no frame is wanted any more.
        owner: of the bytes.
    """

    __slots__ = (
        "_arrived", "_carrier", "_ending", "_flush_due", "_key", "_lagging", "_loop", "_on_closed",
        "_owner", "_reading", "_timer", "closed", "link", "local_address", "reason",
    )  # fmt: skip

    def __init__(
        self,
        link: Link,
        key: str,
        carrier: FrameCarrier,
        on_closed: Callable[[], None],
        owner: TransportOwner,
    ) -> None:
        self.link = link
        self.local_address = ""  # nobody who comes by a link is near
        self.reason: LinkEnded | None = None
        """Why the link ended, if not in order."""
        self.closed = False
        self._key = key
        self._carrier = carrier
        self._on_closed = on_closed
        self._owner = owner
        self._loop = asyncio.get_running_loop()
        self._arrived: deque[Bytes] = deque()
        self._timer: asyncio.TimerHandle | None = None
        self._reading = self._lagging = self._flush_due = self._ending = False

    # -- frames

    def frame_received(self, frame: bytes) -> None:
        """Take a frame of this link."""
        if self.closed:
            return
        try:
            self._arrived.extend(self.link.receive(frame, self._loop.time()))
        except LinkEnded as error:
            self._break(error)
            return
        except BaseException:  # a bug: nothing more passes
            self.abort()
            raise
        if self._arrived:
            self._deliver()
        self._flush_soon()

    def validated(self) -> None:
        """The peer is authenticated: the link may carry as much as it can."""
        if not self.closed:
            self.link.validated()
            self._flush_soon()

    def _flush_soon(self) -> None:
        """Once for all frames of this turn: many are acknowledged together."""
        if not self._flush_due:
            self._flush_due = True
            self._loop.call_soon(self._flush)

    def _flush(self) -> None:
        self._flush_due = False
        if self.closed:
            return
        self._send()
        if self._lagging and self.link.backlog == 0:
            self._lagging = False
            self._owner.resume_writing()
        self._settle()

    def _send(self) -> None:
        link, put = self.link, self._carrier.put
        for frame in link.frames_to_send(self._loop.time()):
            put(self._key, frame)
        deadline = link.deadline()
        if deadline is not None and (self._timer is None or deadline < self._timer.when()):
            self._arm(deadline)

    def _settle(self) -> None:
        """Has the peer ended its stream, or is the link over?"""
        if self.closed:
            return
        link = self.link
        if link.peer_ended and self._reading and not self._arrived and not self._ending:
            self._ending = True
            self._reading = False
            self._owner.eof_received()
            self.finish()
        elif link.state in ENDED:
            self._close()

    # -- reading

    @property
    def reading(self) -> bool:
        """Whether arriving bytes are read."""
        return self._reading

    def resume_reading(self) -> None:
        """Read whenever bytes arrive, and those that wait."""
        if not (self._reading or self._ending or self.closed):
            self._reading = True
            if self._arrived or self.link.peer_ended:
                self._loop.call_soon(self._read_on)

    def _read_on(self) -> None:
        if not self.closed:
            self._deliver()
            self._flush_soon()

    def pause_reading(self) -> None:
        """Leave what arrives in the link, whose window slows the peer."""
        self._reading = False

    def _deliver(self) -> None:
        arrived, link = self._arrived, self.link
        while arrived and self._reading and not self.closed:
            piece = arrived.popleft()
            buffer = self._owner.get_buffer()
            count = len(piece)
            if count > len(buffer):
                count = len(buffer)
                arrived.appendleft(memoryview(piece)[count:])
                piece = memoryview(piece)[:count]
            buffer[:count] = piece
            link.consumed(count, self._loop.time())
            try:
                self._owner.buffer_updated(count)
            except BaseException:  # a bug, perhaps in a guard: nothing more passes
                self.abort()
                raise

    # -- writing

    def limit_unsent(self) -> None:
        """Nothing to do: what the link's window does not take waits in `backlog`."""

    @property
    def backlog(self) -> int:
        """Bytes that wait for the link's window."""
        return self.link.backlog

    @property
    def writable(self) -> bool:
        """Whether a writer need not wait."""
        return self.link.writable

    def write(self, data: Bytes) -> None:
        """Send `data`, which may change afterwards."""
        if self.closed:
            return
        self.link.write(data, self._loop.time())
        self._send()
        if self.link.backlog:
            self._lagging = True

    # -- ends

    def write_eof(self) -> None:
        """End this side's stream after what was written."""
        if not self.closed:
            self.link.finish(self._loop.time())
            self._flush_soon()

    def finish(self) -> None:
        """Close once everything is written: both sides have closed."""
        self._ending, self._reading = True, False
        self.write_eof()

    def abort(self) -> None:
        """End the link now; what was not sent is dropped, and the peer is told."""
        if self.closed:
            return
        if self.link.state not in ENDED:
            self._carrier.put(self._key, self.link.reset())
        self._close()

    def _break(self, error: LinkEnded) -> None:
        self.reason = error.bare()
        for frame in self.link.frames_to_send(self._loop.time()):
            self._carrier.put(self._key, frame)
        self._close()

    def _close(self) -> None:
        self.closed = True
        self._reading = False
        self._arrived.clear()
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        self._on_closed()
        self._loop.call_soon(self._owner.connection_lost)
        del self._owner, self._on_closed  # no reference cycle with the owner

    # -- time

    def _arm(self, deadline: float) -> None:
        """One timer for all deadlines: when it fires too early, it is set again."""
        if self._timer is not None:
            self._timer.cancel()
        self._timer = self._loop.call_at(deadline, self._on_timer)

    def _on_timer(self) -> None:
        self._timer = None
        now = self._loop.time()
        try:
            self.link.tick(now)
        except LinkEnded as error:
            self._break(error)
            return
        since = self.link.silent_since
        if since is not None and now - max(since, self._carrier.heard_at) > STALLED:
            self._carrier.reopen()
        self._flush()


def idle_round_trip(stream: BaseStream) -> float:
    """The shortest round trip of the link under a stream; 0: none yet, or it is not over a link."""
    transport = stream.transport
    return transport.link.stats.least_s if isinstance(transport, LinkTransport) else 0.0


def stats_of(stream: BaseStream) -> LinkStats:
    """What the link under a stream measured.

    Raises:
        TypeError: the stream is not over a link.
    """
    if not isinstance(stream.transport, LinkTransport):
        raise TypeError("this connection is not over a link")
    return stream.transport.link.stats
