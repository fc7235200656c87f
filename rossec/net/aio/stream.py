"""`SecureStream`: one `Connection` on an asyncio loop, what `connect` and `serve` return.

A *unit* is the data of one `send`; it arrives whole. Framing inside a unit is TCPROS's or HTTP's own, and
small units sent in one burst are joined into one: a receiver takes units as a stream of bytes that never
breaks inside what was sent together. The class has the transport, the timer and back-pressure, and no
decisions; what arrives is read straight into the loop's memory or the connection's, and opened there.
"""

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from contextlib import suppress
from functools import partial
from time import monotonic
from typing import Final, Generic, Protocol, Self

from rossec import clock
from rossec.channel import negotiation
from rossec.channel.connection import Connection
from rossec.channel.edhoc.credentials import PeerT
from rossec.channel.negotiation import Authenticated, UnitReceived
from rossec.channel.records import Bytes
from rossec.channel.tuning import JOIN_UNITS_BELOW, JOINED_UNITS
from rossec.errors import ChannelClosed, ChannelError
from rossec.net import read_buffers
from rossec.net.aio.transport import BaseStream, ByteTransport, TransportOwner
from rossec.net.context import forget_in_children
from rossec.ros.tcpros import PATIENCE, Framing

LINGER: Final = 5.0  # seconds to wait for the peer's FIN after the last flight
_BURST: Final = 1 / 3  # of the time a record took: a turn of the loop takes longer, on any machine


class UnitSource(Protocol):
    def receive(self) -> Awaitable[bytes]: ...


def wall_clock() -> int:  # never ROS time
    return clock.now()


class SecureStream(BaseStream, Generic[PeerT]):
    """One authenticated connection on a loop; it owns its transport and starts at once. `transport` makes
    what carries its bytes: `partial(Transport, sock)` for a connected socket."""

    __slots__ = (
        "__weakref__",
        "_abort_at",
        "_burst_until",
        "_flush_due",
        "_join",
        "_limit",
        "_on_authenticated",
        "_on_end",
        "_on_renewal",
        "_queue",
        "_queued",
        "_small",
        "_socket_closed",
        "_timer",
        "_turn",
        "_untold",
        "_when_closed",
        "address",
        "authenticated",
        "connection",
        "get_buffer",
        "peer",
    )
    peer: PeerT  # the identity of the peer's certificate, once it is authenticated
    _on_authenticated: Callable[[Self], None] | None
    _on_end: Callable[[Self, ChannelError], None]

    def __init__(
        self,
        connection: Connection[PeerT],
        transport: Callable[[TransportOwner], ByteTransport],
        address: str,  # the peer's
        on_authenticated: Callable[[Self], None],  # called once
        on_end: Callable[[Self, ChannelError], None],  # called once, with the reason
    ) -> None:
        super().__init__()
        self._turn = asyncio.Lock()
        self._queue: list[bytes] = []
        self._queued = 0
        self._flush_due = False
        self._burst_until = 0.0
        self._limit = connection.unit_limit
        self._join = min(JOINED_UNITS, self._limit)
        self._small = min(JOIN_UNITS_BELOW, self._limit)
        self.connection = connection
        forget_in_children(connection)
        self._on_authenticated = on_authenticated
        self._on_end = on_end
        self._timer: asyncio.TimerHandle | None = None
        self._abort_at = 0.0
        self._socket_closed = False
        self._when_closed: list[Callable[[], None]] | None = None
        self.authenticated = False
        self._on_renewal: Callable[[negotiation.Renewal[PeerT]], None] | None = None
        self._untold: negotiation.Renewal[PeerT] | None = None
        self.address = address
        self.transport = transport(self)
        # The socket's reader calls the core itself. All connections of a loop read into the same memory.
        self.get_buffer = partial(connection.get_buffer, read_buffers.of_loop(self._loop))
        self.flush()
        self.transport.resume_reading()
        self._arm()
        if connection.streams is not None:
            connection.streams.add(self)

    # -- called by the transport

    def buffer_updated(self, count: int) -> None:
        events: Sequence[negotiation.Event[PeerT]] = ()
        try:
            unit = self.connection.lone_unit(count)
            if unit is None:
                events = self.connection.buffer_updated(count, wall_clock())
        except ChannelError as error:
            self.fail(error)
            return
        if unit is not None:
            if self._take is None or self._units is not None or not self._take(unit):
                self._deliver(unit)
                if self._units:
                    self._notify()
            return
        if self.authenticated or not events:
            self.flush()
        if len(events) == 1 and self._take is not None and self._units is None:
            event = events[0]
            if isinstance(event, UnitReceived) and self._take(event.data):
                return
        self._handle_events(events)
        if self.connection.has_unfinished_unit:
            self._arm()

    def _handle_events(self: Self, events: Sequence[negotiation.Event[PeerT]]) -> None:
        for event in events:
            if isinstance(event, UnitReceived):
                self._deliver(event.data)
            elif isinstance(event, Authenticated):
                self.peer = event.identity
                self.authenticated = True
                called, self._on_authenticated = self._on_authenticated, None
                if called is not None:
                    called(self)
                # The last flight leaves with what is sent in this turn: two writes and wake-ups less (0008).
                self._loop.call_soon(self.flush)
                self._arm()
            elif not isinstance(event, negotiation.Closed):
                if isinstance(event, negotiation.IdentityRenewed):
                    self.peer = event.identity
                    self._arm()
                if self._on_renewal is not None:
                    self._on_renewal(event)
                elif isinstance(event, negotiation.GrantsPresented):
                    self._untold = event
            else:
                self.flush()
                self._end(ChannelClosed("the peer closed the connection"))
                self.transport.finish()  # both sides have closed
        if self._units:
            self._notify()

    def eof_received(self) -> None:
        try:
            self.connection.receive_eof()
        except ChannelError as error:
            self.fail(error)

    def resume_writing(self) -> None:
        self._wake_waiters()

    def connection_lost(self) -> None:
        self._cancel_timer()
        if self.error is None:
            self.eof_received()
            self._end(ChannelClosed("the connection is closed"))
        self._socket_closed = True
        self._wake_waiters()
        callbacks, self._when_closed = self._when_closed, None
        for callback in callbacks or ():
            callback()
        del self._on_authenticated, self._on_end  # no reference cycle with the owner

    # -- for users

    @property
    def local_address(self) -> str:
        return self.transport.local_address

    def when_closed(self, callback: Callable[[], None]) -> None:
        if self._socket_closed:
            callback()
            return
        if self._when_closed is None:
            self._when_closed = []
        self._when_closed.append(callback)

    def on_renewal(self, callback: Callable[[negotiation.Renewal[PeerT]], None]) -> None:
        self._on_renewal = callback
        untold, self._untold = self._untold, None
        if untold is not None:
            callback(untold)

    def present_identity(self, chain: Sequence[bytes]) -> None:
        if self.error is None:
            self.connection.present_identity(chain)
            self.flush()

    def present_grants(self, data: bytes) -> bool:
        if self.error is not None or not self.connection.present_grants(data):
            return False
        self.flush()
        return True

    def raise_unit_limit(self, limit: int | None = None) -> None:
        self.check()
        self.connection.raise_unit_limit(limit)

    def write(self, record: Bytes) -> None:
        self.check()
        self.transport.write(record)

    def flush(self) -> None:
        data = self.connection.data_to_send()
        if data:
            self.transport.write(data)

    def disconnect(self) -> None:
        """Let nothing pass any more and call nothing back; `abort` follows in this turn, with the reason."""
        self.transport.disconnect()

    def abort(self, reason: str) -> None:
        # At once, for example because the peer's grant was revoked; the peer sees a truncation. The socket
        # first: whoever is told here may take its time.
        self.transport.abort()
        self._end(ChannelClosed(reason))

    def fail(self, error: ChannelError) -> None:
        self.flush()
        self._end(error, linger=True)

    def _end(self: Self, error: ChannelError, *, linger: bool = False) -> None:
        if self.error is not None:
            return
        self.error = error.bare()
        if linger and not self.transport.closed:
            # Send FIN; wait for the peer's, or a reset would discard the last flight.
            self.transport.write_eof()
            self.transport.resume_reading()
            self._abort_at = self._loop.time() + LINGER
            self._arm_timer(LINGER)
        self._on_end(self, error)
        self._notify()

    # -- time

    def _arm(self) -> None:
        deadline = self.connection.deadline()
        if deadline is not None:
            # A day at most: the host's clock may be set meanwhile.
            self._arm_timer(min(max(0.0, deadline - clock.time()), 86400.0))

    def _arm_timer(self, delay: float) -> None:
        at = self._loop.time() + delay
        if self._timer is None or at < self._timer.when():
            self._cancel_timer()
            self._timer = self._loop.call_at(at, self._on_timer)

    def _on_timer(self) -> None:
        self._timer = None
        if self.error is None:
            self._run_timers()
        elif self._loop.time() >= self._abort_at:
            self.transport.abort()
        else:
            self._arm_timer(self._abort_at - self._loop.time())

    def _run_timers(self) -> None:
        try:
            self.connection.tick(wall_clock(), reading=self.transport.reading)
        except ChannelError as error:
            self.fail(error)
            return
        self.flush()
        self._arm()

    def _cancel_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    # -- sending

    async def send(self, *pieces: Bytes) -> None:
        """Send the pieces as one unit, after what is queued; waits while the peer lags.

        A small unit leaves at once, unless it follows another one within a part of the time that
        one took to send: such a burst is joined in one record, which leaves at the end of this turn
        of the loop. A large one must not change until this returns; a `send` of one that is
        cancelled while it waits for the peer drops the connection, as half a unit was sent.
        """
        size = 0
        for piece in pieces:
            size += piece.nbytes if isinstance(piece, memoryview) else len(piece)
        free = self.error is None and self.transport.writable and not self._turn.locked()
        if free and size < self._small:
            self._send_small(pieces, size)
            return
        async with self._turn:
            await self.drain()
            self._flush_queue()
            records = self.connection.seal_unit(*pieces, reuse=True)
            try:
                for record in records:  # written as it is sealed: one sealed meanwhile must come after it
                    self.write(record)
                    if not self.transport.writable:
                        await self.drain()
            except BaseException:
                self.abort("a message was given up half-way")
                raise

    def _send_small(self, pieces: tuple[Bytes, ...], size: int) -> None:
        if size == 0:
            return
        piece = pieces[0] if len(pieces) == 1 else b"".join(pieces)
        unit = piece if isinstance(piece, bytes) else bytes(piece)
        if not self._queue and monotonic() > self._burst_until:
            self._write_now(unit)  # the first of a burst does not wait; the others are joined
            return
        if self._queued + size > self._join:
            self._try_flush()
        self._queue.append(unit)
        self._queued += size
        if not self._flush_due:
            self._flush_due = True
            self._loop.call_soon(self._flush_soon)

    def _flush_soon(self, _: object = None) -> None:
        self._flush_due = False
        with suppress(ChannelError):  # the connection has ended: its users get the error
            self._try_flush()

    def _try_flush(self) -> None:
        # Flush unless a write is in progress or the peer lags; then the next writer does.
        if self._turn.locked() or self.error is not None:
            return
        if self.transport.writable:
            self._flush_queue()
        elif not self._flush_due:
            self._flush_due = True
            self._changed().add_done_callback(self._flush_soon)

    def _flush_queue(self) -> None:
        if not self._queue:
            return
        queue, self._queue = self._queue, []
        # Joined they could be longer than a unit may be.
        units = queue if self._queued > self._limit else [b"".join(queue)]
        self._queued = 0
        for unit in units:
            self._write_now(unit)

    def _write_now(self, unit: bytes) -> None:
        began = monotonic()
        try:
            record = self.connection.seal_small(unit)
            if record is not None:
                self.write(record)
            else:
                for each in self.connection.seal_unit(unit):
                    self.write(each)
        except ChannelError as error:
            self.fail(error)
            raise
        ended = monotonic()
        self._burst_until = ended + (ended - began) * _BURST

    def write_nowait(self, data: Bytes) -> bool:
        """Send `data` now, as one unit, even if the peer lags; false: it does, `drain`.

        For the only sender of a connection, which then waits: what the socket does not take is
        buffered without a limit.
        """
        self.check()
        if self._queue:
            self._flush_queue()
        transport = self.transport
        small = self.connection.seal_small(data)
        if small is not None:
            transport.write(small)
        else:
            for record in self.connection.seal_unit(data, reuse=True):
                transport.write(record)
        return transport.writable

    def pad_units(self, multiple: int) -> None:
        """Pad what is sent from now on, not what is queued, to a multiple of so many bytes; 0: do not."""
        if self.error is None and not self._turn.locked():
            with suppress(ChannelError):  # the connection has ended: its users get the error
                self._flush_queue()
        self.connection.pad_units(multiple)

    async def close(self) -> None:
        """Send what is queued, then close in order; wait for the peer's close, but not for long."""
        self.close_soon()
        while not self._socket_closed:
            await self._changed()

    def close_soon(self) -> None:
        """As `close`, without waiting for the peer: it may keep its end open for seconds."""
        if self.error is None and not self._turn.locked():
            self._flush_queue()
        if self.error is None:
            self.connection.close()
            self.flush()
            self._end(ChannelClosed("the connection was closed"), linger=True)

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            await self.close()
        else:
            self.abort("the user of the connection failed")


async def next_messages(source: UnitSource, framing: Framing) -> list[bytes]:
    """The messages that the next bytes complete, possibly none; each must make progress."""
    while framing.incomplete:
        try:
            async with asyncio.timeout(PATIENCE):
                data = await source.receive()
        except TimeoutError:
            framing.check_progress(clock.now())
        else:
            return framing.feed(data, clock.now())
    return framing.feed(await source.receive(), clock.now())
