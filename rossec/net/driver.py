"""The asyncio protocol around one `Connection`: sockets, timers and back-pressure, no decisions.

The socket writes straight into the connection's receive buffer. Reading pauses while the consumer
lags, writing waits while the peer does. `rossec.net.secure.SecureStream` is what users hold.
"""

import asyncio
import socket
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import Final, Generic, cast

from rossec.channel.connection import Connection
from rossec.channel.credentials import PeerT
from rossec.channel.records import Bytes
from rossec.channel.states import Authenticated, Closed, UnitReceived
from rossec.errors import ChannelClosed, ChannelError, ConnectionTruncated

_PAUSE_ABOVE: Final = 1024 * 1024  # bytes delivered and not taken
_LINGER: Final = 5.0  # seconds to wait for the peer's end after the last flight


def wall_clock() -> int:
    """The host's clock in whole seconds; never ROS time."""
    return int(time.time())


class Driver(asyncio.BufferedProtocol, Generic[PeerT]):
    """One connection on a loop.

    Args:
        connection: the core.
        on_authenticated: called once, with the peer.
        on_end: called once, when the handshake or the connection is over, with the reason.
    """

    def __init__(
        self,
        connection: Connection[PeerT],
        on_authenticated: Callable[["Driver[PeerT]", PeerT], None],
        on_end: Callable[["Driver[PeerT]", ChannelError], None],
    ) -> None:
        self.connection = connection
        self._on_authenticated = on_authenticated
        self._on_end = on_end
        self._loop = asyncio.get_running_loop()
        self._transport: asyncio.Transport | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._units: deque[bytes] = deque()
        self._unread = 0
        self._reading = True
        self._arrived = asyncio.Event()
        self._writable = asyncio.Event()
        self._writable.set()
        self._lost = asyncio.Event()
        self.ended = asyncio.Event()
        self._when_writable: list[Callable[[], None]] = []
        self.authenticated = False
        self.error: ChannelError | None = None
        self.address = ""
        self.local_address = ""

    # -- called by the loop

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Send the first flight, start the clock."""
        self._transport = cast("asyncio.Transport", transport)
        self.learn_address(transport)
        # asyncio does this only for sockets made with an explicit IPPROTO_TCP; ours are not.
        sock = transport.get_extra_info("socket")
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.flush()
        self._arm()

    def learn_address(self, transport: asyncio.BaseTransport) -> None:
        """Note the IP addresses of both ends."""
        peername = transport.get_extra_info("peername")
        self.address = peername[0] if peername else ""
        sockname = transport.get_extra_info("sockname")
        self.local_address = sockname[0] if sockname else ""

    def refuse(self, transport: asyncio.BaseTransport) -> None:
        """Drop a connection before anything was spent on it."""
        self.error = ChannelClosed("too many unfinished handshakes")
        cast("asyncio.Transport", transport).abort()

    def get_buffer(self, sizehint: int) -> memoryview:  # noqa: ARG002 - asyncio's signature
        """Lend the socket the connection's own buffer."""
        return self.connection.get_buffer()

    def buffer_updated(self, nbytes: int) -> None:
        """Hand the bytes to the core and its events to the consumer."""
        try:
            events = self.connection.buffer_updated(nbytes, wall_clock())
        except ChannelError as error:
            self._fail(error)
            return
        self.flush()
        for event in events:
            match event:
                case UnitReceived(data):
                    self._units.append(data)
                    self._unread += len(data)
                case Authenticated(identity):
                    self.authenticated = True
                    self._on_authenticated(self, identity)
                    self._arm()
                case Closed():
                    self._end(ChannelClosed("the peer closed the connection"))
        if self._units:
            self._arrived.set()
            if self._unread > _PAUSE_ABOVE and self._reading:
                self._reading = False
                self._transport_or_raise().pause_reading()

    def eof_received(self) -> bool:
        """The peer ended the stream; without its close that is a truncation."""
        try:
            self.connection.receive_eof()
        except ChannelError as error:
            self._fail(error)
        return False

    def connection_lost(self, exc: Exception | None) -> None:  # noqa: ARG002 - asyncio's signature
        """Whatever the reason, wake everyone who waits."""
        self._cancel_timer()
        if self.error is None:
            try:
                self.connection.receive_eof()
                self._end(ChannelClosed("the connection is closed"))
            except ChannelError as error:
                self._end(error)
        self._lost.set()
        self._writable.set()

    def pause_writing(self) -> None:
        """The peer reads slower than this side writes."""
        self._writable.clear()

    def resume_writing(self) -> None:
        """The peer caught up."""
        self._writable.set()
        callbacks, self._when_writable = self._when_writable, []
        for callback in callbacks:
            callback()

    # -- called by the stream

    @property
    def writable(self) -> bool:
        """Whether a write would not pile up."""
        return self._writable.is_set()

    def when_writable(self, callback: Callable[[], None]) -> None:
        """Call back, once, when the peer caught up."""
        self._when_writable.append(callback)

    async def drain(self) -> None:
        """Wait until the peer caught up.

        Raises:
            ChannelError: the connection ended meanwhile.
        """
        if not self._writable.is_set():
            await self._writable.wait()
        if self.error is not None:
            raise self.error

    def write(self, record: Bytes) -> None:
        """Write a record the core has just sealed."""
        self._transport_or_raise().write(record)

    def flush(self) -> None:
        """Write whatever the core queued by itself."""
        data = self.connection.data_to_send()
        if data and self._transport is not None and not self._transport.is_closing():
            self._transport.write(data)

    async def receive(self) -> bytes:
        """Return the next unit.

        Raises:
            ChannelError: there will be none.
        """
        while not self._units:
            if self.error is not None:
                raise self.error
            self._arrived.clear()
            await self._arrived.wait()
        unit = self._units.popleft()
        self._unread -= len(unit)
        if not self._reading and self._unread <= _PAUSE_ABOVE // 2:
            self._reading = True
            if self.error is None:
                self._transport_or_raise().resume_reading()
        return unit

    async def close(self) -> None:
        """Close in order; wait for the peer's end, but not for long."""
        if self.error is None:
            self.connection.close()
            self.flush()
            self._end(ChannelClosed("the connection was closed"))
        with suppress(TimeoutError):
            async with asyncio.timeout(_LINGER):
                await self._lost.wait()
        self._abort_transport()

    def abort(self, error: ChannelError) -> None:
        """Cut the connection; the peer sees a truncation."""
        self._end(error)
        self._abort_transport()

    # -- ends

    def _fail(self, error: ChannelError) -> None:
        self.flush()
        self._end(error)

    def _end(self, error: ChannelError) -> None:
        """The one place where a connection ends for its users."""
        if self.error is not None:
            return
        self.error = error
        self.ended.set()
        self._cancel_timer()
        self._arrived.set()
        self._writable.set()
        self._linger()
        self._on_end(self, error)

    def _linger(self) -> None:
        """End this side; wait for the peer's end, or the reset would swallow the last flight."""
        transport = self._transport
        if transport is None or transport.is_closing():
            return
        if not self._reading:
            self._reading = True
            transport.resume_reading()
        with suppress(OSError):  # the peer may have reset the connection already
            transport.write_eof()
        self._timer = self._loop.call_later(_LINGER, self._abort_transport)

    def _abort_transport(self) -> None:
        if self._transport is not None:
            self._transport.abort()

    def _transport_or_raise(self) -> asyncio.Transport:
        if self._transport is None or self.error is not None:
            raise self.error or ConnectionTruncated("the connection was never made")
        return self._transport

    # -- time

    def _arm(self) -> None:
        self._cancel_timer()
        deadline = self.connection.deadline()
        if deadline is not None:
            delay = max(0.0, deadline - time.time())
            # A day at most: the host's clock may be set while we wait.
            self._timer = self._loop.call_later(min(delay, 86400.0), self._tick)

    def _tick(self) -> None:
        try:
            self.connection.tick(wall_clock())
        except ChannelError as error:
            self._fail(error)
            return
        self.flush()
        self._arm()

    def _cancel_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
