"""One `Connection` on an asyncio loop: its transport, timer and back-pressure, no decisions.

What arrives is read straight into the connection's receive buffer. What is sent, and when, is in
`rossec.net.aio.stream.SecureStream`, which users hold.
"""

import asyncio
from collections.abc import Callable, Sequence
from typing import Final, Generic, Self

from rossec import clock
from rossec.channel.connection import Connection
from rossec.channel.edhoc.credentials import PeerT
from rossec.channel.records import Bytes
from rossec.channel.states import (
    Authenticated,
    Closed,
    Event,
    GrantsPresented,
    IdentityRenewed,
    Renewal,
    UnitReceived,
)
from rossec.errors import ChannelClosed, ChannelError
from rossec.net.aio.base import BaseStream
from rossec.net.aio.transport import ByteTransport, TransportOwner
from rossec.net.forks import forget_in_children

LINGER: Final = 5.0  # seconds to wait for the peer's FIN after the last flight


def wall_clock() -> int:
    """The host's clock in whole seconds; never ROS time."""
    return clock.now()


class Driver(BaseStream, Generic[PeerT]):
    """One connection on a loop; it owns its transport and starts at once.

    `peer` is the identity of the peer's certificate, once it is authenticated.

    Args:
        connection: the core.
        transport: makes what carries its bytes: `partial(Transport, sock)` for a connected socket.
        address: the peer's IP address.
        on_authenticated: called once.
        on_end: called once, when the handshake or the connection is over, with the reason.
    """

    peer: PeerT
    _on_authenticated: Callable[[Self], None]
    _on_end: Callable[[Self, ChannelError], None]

    def __init__(
        self,
        connection: Connection[PeerT],
        transport: Callable[[TransportOwner], ByteTransport],
        address: str,
        on_authenticated: Callable[[Self], None],
        on_end: Callable[[Self, ChannelError], None],
    ) -> None:
        super().__init__()
        self.connection = connection
        forget_in_children(connection)
        self._on_authenticated = on_authenticated
        self._on_end = on_end
        self._timer: asyncio.TimerHandle | None = None
        self._abort_at = 0.0
        self._socket_closed = False
        self._when_closed: list[Callable[[], None]] | None = None
        self.authenticated = False
        self._on_renewal: Callable[[Renewal[PeerT]], None] | None = None
        self._untold: Renewal[PeerT] | None = None
        self.address = address
        self.transport = transport(self)
        self.get_buffer = connection.get_buffer  # the socket's reader calls the core itself
        self.flush()
        self.transport.resume_reading()
        self._arm()
        if connection.streams is not None:
            connection.streams.add(self)

    # -- called by the transport

    def buffer_updated(self, count: int) -> None:
        """Hand the bytes to the core and its events to the consumer."""
        try:
            events = self.connection.buffer_updated(count, wall_clock())
        except ChannelError as error:
            self.fail(error)
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

    def _handle_events(self, events: Sequence[Event[PeerT]]) -> None:
        for event in events:
            if isinstance(event, UnitReceived):
                self._deliver(event.data)
            elif isinstance(event, Authenticated):
                self._handle_authenticated(event.identity)
            elif not isinstance(event, Closed):
                self._handle_renewal(event)
            else:
                self.flush()
                self._end(ChannelClosed("the peer closed the connection"))
                self.transport.finish()  # both sides have closed
        if self._units:
            self._notify()

    def _handle_authenticated(self: Self, peer: PeerT) -> None:
        """Report the peer; what is sent at once leaves with the last flight."""
        self.peer = peer
        self.authenticated = True
        self._on_authenticated(self)
        self._loop.call_soon(self.flush)
        self._arm()

    def _handle_renewal(self: Self, event: Renewal[PeerT]) -> None:
        """Tell the user at once: what arrives after it is judged by what is in force then."""
        if isinstance(event, IdentityRenewed):
            self.peer = event.identity
            self._arm()
        if self._on_renewal is not None:
            self._on_renewal(event)
        elif isinstance(event, GrantsPresented):
            self._untold = event

    def eof_received(self) -> None:
        """The peer ended the stream; without its close that is a truncation."""
        try:
            self.connection.receive_eof()
        except ChannelError as error:
            self.fail(error)

    def resume_writing(self) -> None:
        """The peer caught up."""
        self._wake_waiters()

    def connection_lost(self) -> None:
        """Wake all waiters, whatever the reason."""
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
        """As of `ByteTransport.local_address`."""
        return self.transport.local_address

    def when_closed(self, callback: Callable[[], None]) -> None:
        """Call back, once, when the socket is closed: some time after the connection ended."""
        if self._socket_closed:
            callback()
            return
        if self._when_closed is None:
            self._when_closed = []
        self._when_closed.append(callback)

    def on_renewal(self, callback: Callable[[Renewal[PeerT]], None]) -> None:
        """Call back with what the peer renews; the grants that it presented before at once."""
        self._on_renewal = callback
        untold, self._untold = self._untold, None
        if untold is not None:
            callback(untold)

    @property
    def takes_renewals(self) -> bool:
        """As of `Connection`."""
        return self.connection.takes_renewals

    def present_identity(self, chain: Sequence[bytes]) -> None:
        """As of `Connection`, and send it."""
        if self.error is None:
            self.connection.present_identity(chain)
            self.flush()

    def present_grants(self, data: bytes) -> bool:
        """As of `Connection`, and send them; false: the peer takes none, or it has ended."""
        if self.error is not None or not self.connection.present_grants(data):
            return False
        self.flush()
        return True

    def raise_unit_limit(self, limit: int | None = None) -> None:
        """Accept units of up to `limit`, or `ChannelLimits.unit`: the peer is authorized.

        Raises:
            ChannelError: the connection has ended.
        """
        self.check()
        self.connection.raise_unit_limit(limit)

    def pad_units(self, multiple: int) -> None:
        """Pad what is sent from now on to a multiple of so many bytes; 0: do not."""
        self.connection.pad_units(multiple)

    def write(self, record: Bytes) -> None:
        """Write a record the core has just sealed.

        Raises:
            ChannelError: the connection has ended.
        """
        self.check()
        self.transport.write(record)

    def flush(self) -> None:
        """Write what the core has queued."""
        data = self.connection.data_to_send()
        if data:
            self.transport.write(data)

    def _begin_close(self) -> None:
        """Close in order, without waiting: the socket is closed with the peer's, or soon."""
        if self.error is None:
            self.connection.close()
            self.flush()
            self._end(ChannelClosed("the connection was closed"), linger=True)

    async def _close(self) -> None:
        """Close in order; wait for the peer's, but not for long."""
        self._begin_close()
        while not self._socket_closed:
            await self._changed()

    def abort(self, reason: str) -> None:
        """Abort the connection at once, for example because the peer's grant was revoked.

        The peer sees a truncation.
        """
        self._end(ChannelClosed(reason))
        self.transport.abort()

    def fail(self, error: ChannelError) -> None:
        """End the connection after the core's last flight, if it has one."""
        self.flush()
        self._end(error, linger=True)

    def _end(self: Self, error: ChannelError, *, linger: bool = False) -> None:
        """End the connection for its users: every end passes here."""
        if self.error is not None:
            return
        self.error = error.bare()
        if linger:
            self._linger()
        self._on_end(self, error)
        self._notify()

    def _linger(self) -> None:
        """Send FIN; wait for the peer's, or a reset would discard the last flight."""
        if not self.transport.closed:
            self.transport.write_eof()
            self.transport.resume_reading()
            self._abort_at = self._loop.time() + LINGER
            self._arm_timer(LINGER)

    # -- time

    def _arm(self) -> None:
        deadline = self.connection.deadline()
        if deadline is not None:
            # A day at most: the host's clock may be set meanwhile.
            self._arm_timer(min(max(0.0, deadline - clock.time()), 86400.0))

    def _arm_timer(self, delay: float) -> None:
        """One timer for all deadlines: when it fires too early, it is set again."""
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
