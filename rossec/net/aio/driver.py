"""One `Connection` on an asyncio loop: its socket, timer and back-pressure, no decisions.

The socket writes straight into the connection's receive buffer. Reading pauses while the consumer
lags, writing waits while the peer does. `rossec.net.aio.stream.SecureStream` is what users hold.
"""

import asyncio
import socket
from collections import deque
from collections.abc import Awaitable, Callable, Sequence
from copy import copy
from typing import Final, Generic, NoReturn

from rossec import clock
from rossec.channel.connection import Connection
from rossec.channel.edhoc.credentials import PeerT
from rossec.channel.records import Bytes
from rossec.channel.states import Authenticated, Event, UnitReceived
from rossec.errors import ChannelClosed, ChannelError
from rossec.net.aio.transport import Transport
from rossec.net.forks import forget_in_children

_PAUSE_ABOVE: Final = 1024 * 1024  # bytes delivered and not taken
_LINGER: Final = 5.0  # seconds to wait for the peer's end after the last flight


def wall_clock() -> int:
    """The host's clock in whole seconds; never ROS time."""
    return clock.now()


class Driver(Generic[PeerT]):
    """One connection on a loop; it owns `sock` and begins at once.

    Args:
        connection: the core.
        sock: a connected TCP socket.
        address: the peer's IP address.
        on_authenticated: called once, with the peer.
        on_end: called once, when the handshake or the connection is over, with the reason.
    """

    def __init__(
        self,
        connection: Connection[PeerT],
        sock: socket.socket,
        address: str,
        on_authenticated: Callable[["Driver[PeerT]", PeerT], None],
        on_end: Callable[["Driver[PeerT]", ChannelError], None],
    ) -> None:
        self.connection = connection
        forget_in_children(connection)
        self._on_authenticated = on_authenticated
        self._on_end = on_end
        self._loop = asyncio.get_running_loop()
        self._timer: asyncio.TimerHandle | None = None
        self._cut_at = 0.0
        self._units: deque[bytes] | None = None  # None: an empty one has its price
        self._unread = 0
        self._push: Callable[[bytes], bool] | None = None
        self._push_failed: BaseException | None = None
        self._waiting: list[asyncio.Future[None]] = []
        self._when_writable: list[Callable[[], None]] = []
        self.on_ready: Callable[[], None] | None = None
        self.on_unit: Callable[[bytes], bool] | None = None
        self._lost = False
        self._when_lost: list[Callable[[], None]] | None = None
        self.authenticated = False
        self.error: ChannelError | None = None
        self.address = address
        self.transport = Transport(sock, self)
        self.get_buffer = connection.get_buffer  # the socket's reader calls the core itself
        self.flush()
        self.transport.resume_reading()
        self._arm()

    # -- called by the transport

    def received(self, count: int) -> None:
        """Hand the bytes to the core and its events to the consumer."""
        try:
            events = self.connection.buffer_updated(count, wall_clock())
        except ChannelError as error:
            self.fail(error)
            return
        if self.authenticated or not events:
            self.flush()
        if len(events) == 1 and self.on_unit is not None and self._units is None:
            event = events[0]
            if isinstance(event, UnitReceived) and self.on_unit(event.data):
                return
        self._take_in(events)
        if self.connection.has_unfinished_unit:
            self._arm()

    def _take_in(self, events: Sequence[Event[PeerT]]) -> None:
        for event in events:
            if isinstance(event, UnitReceived):
                self._deliver(event.data)
            elif isinstance(event, Authenticated):
                self._introduce(event.identity)
            else:
                self.flush()
                self._end(ChannelClosed("the peer closed the connection"))
                self.transport.finish()  # both sides have said their last word
        if self._units:
            self._tell()
            if self._unread > _PAUSE_ABOVE and self.error is None:
                self.transport.pause_reading()

    def _introduce(self, peer: PeerT) -> None:
        """Wake whoever waits for the peer; what it says at once travels with the last flight."""
        self.authenticated = True
        self._on_authenticated(self, peer)
        self._loop.call_soon(self.flush)
        self._arm()

    def _deliver(self, unit: bytes) -> None:
        """Pass the unit on at once if somebody pours; keep it otherwise."""
        push = self._push
        if push is None:
            if self._units is None:
                self._units = deque()
            self._units.append(unit)
            self._unread += len(unit)
            return
        try:
            lags = not push(unit)
        except BaseException as error:  # noqa: BLE001 - raised where it belongs, in `pour`
            self._push_failed, lags = error, True
        if lags:
            self._push = None
            self.transport.pause_reading()
            self._wake()

    def eof(self) -> None:
        """The peer ended the stream; without its close that is a truncation."""
        try:
            self.connection.receive_eof()
        except ChannelError as error:
            self.fail(error)

    def drained(self) -> None:
        """The peer caught up."""
        self._wake()
        callbacks, self._when_writable = self._when_writable, []
        for callback in callbacks:
            callback()

    def lost(self) -> None:
        """Whatever the reason, wake everyone who waits."""
        self._cancel_timer()
        if self.error is None:
            self.eof()
            self._end(ChannelClosed("the connection is closed"))
        self._lost = True
        self._wake()
        callbacks, self._when_lost = self._when_lost, None
        for callback in callbacks or ():
            callback()
        del self._on_authenticated, self._on_end  # they hold whoever holds this

    # -- called by the stream

    @property
    def local_address(self) -> str:
        """This side's IP address; empty when the connection is gone."""
        try:
            host: str = self.transport.socket.getsockname()[0]
        except OSError:
            return ""
        return host

    @property
    def writable(self) -> bool:
        """Whether a write would not pile up."""
        return self.transport.writable

    def when_lost(self, callback: Callable[[], None]) -> None:
        """Call back, once, when the socket is closed."""
        if self._lost:
            callback()
            return
        if self._when_lost is None:
            self._when_lost = []
        self._when_lost.append(callback)

    def when_writable(self, callback: Callable[[], None]) -> None:
        """Call back, once, when the peer caught up."""
        self._when_writable.append(callback)

    async def drain(self) -> None:
        """Wait until the peer caught up.

        Raises:
            ChannelError: the connection ended meanwhile.
        """
        if not self.transport.writable:
            while self.transport.backlog > 0 and self.error is None:
                await self._change()
        self.check()

    def check(self) -> None:
        """Raise what ended the connection, if something did.

        A copy: with its traceback the one kept here would keep alive whatever it was raised in.
        """
        if self.error is not None:
            raise copy(self.error)

    def write(self, record: Bytes) -> None:
        """Write a record the core has just sealed.

        Raises:
            ChannelError: the connection has ended.
        """
        self.check()
        self.transport.write(record)

    def flush(self) -> None:
        """Write whatever the core queued by itself."""
        data = self.connection.data_to_send()
        if data:
            self.transport.write(data)

    async def receive(self) -> bytes:
        """Return the next unit.

        Raises:
            ChannelError: there will be none.
        """
        while (unit := self.take()) is None:
            await self._change()
        return unit

    @property
    def has_unit(self) -> bool:
        """Whether a unit has arrived that nobody took."""
        return self._units is not None

    def take(self) -> bytes | None:
        """Return the next unit if it has arrived.

        Raises:
            ChannelError: there will be none.
        """
        if self._units is None:
            self.check()
            return None
        unit = self._units.popleft()
        if not self._units:
            self._units = None
        self._unread -= len(unit)
        if self._unread <= _PAUSE_ABOVE // 2 and self.error is None:
            self.transport.resume_reading()
        return unit

    def _tell(self) -> None:
        """There is something to take, or there will never be."""
        if self.on_ready is not None:
            self.on_ready()
        if self._waiting:
            self._wake()

    async def pour(
        self, push: Callable[[bytes], bool], drain: Callable[[], Awaitable[None]]
    ) -> NoReturn:
        """Pass each unit to `push` as it arrives, without a turn of the loop for it.

        When `push` says no, nothing more is read until `drain` returns.

        Raises:
            ChannelError: there will be no more units; or whatever `push` or `drain` raise.
        """
        try:
            while True:
                while self._units:
                    push(await self.receive())
                    await drain()
                self.check()
                self.transport.resume_reading()
                self._push = push
                while self._is_pouring():
                    await self._change()
                if self._push_failed is not None:
                    raise self._push_failed
                await drain()
        finally:
            self._push = None

    def _is_pouring(self) -> bool:
        return self._push is not None and self.error is None

    def _change(self) -> asyncio.Future[None]:
        """What to await until anything happens; the caller looks whether it was for it."""
        waiter = self._loop.create_future()
        self._waiting.append(waiter)
        return waiter

    def _wake(self) -> None:
        waiting, self._waiting = self._waiting, []
        for waiter in waiting:
            if not waiter.done():
                waiter.set_result(None)

    async def close(self) -> None:
        """Close in order; wait for the peer's end, but not for long."""
        if self.error is None:
            self.connection.close()
            self.flush()
            self._end(ChannelClosed("the connection was closed"), linger=True)
        while not self._lost:
            await self._change()

    async def wait_ended(self) -> None:
        """Return when the connection is at its end."""
        while self.error is None:
            await self._change()

    def abort(self, error: ChannelError) -> None:
        """Cut the connection; the peer sees a truncation."""
        self._end(error)
        self.transport.abort()

    def fail(self, error: ChannelError) -> None:
        """End the connection after the core's last flight, if it has one."""
        self.flush()
        self._end(error, linger=True)

    def _end(self, error: ChannelError, *, linger: bool = False) -> None:
        """The one place where a connection ends for its users."""
        if self.error is not None:
            return
        self.error = error
        if linger:
            self._linger()
        self._on_end(self, error)
        self._tell()

    def _linger(self) -> None:
        """End this side; wait for the peer's end, or the reset would swallow the last flight."""
        if not self.transport.closed:
            self.transport.write_eof()
            self.transport.resume_reading()
            self._cut_at = self._loop.time() + _LINGER
            self._look_within(_LINGER)

    # -- time

    def _arm(self) -> None:
        deadline = self.connection.deadline()
        if deadline is not None:
            # A day at most: the host's clock may be set while we wait.
            self._look_within(min(max(0.0, deadline - clock.time()), 86400.0))

    def _look_within(self, delay: float) -> None:
        """One timer does: when it fires too early for anything, it is set again."""
        at = self._loop.time() + delay
        if self._timer is None or at < self._timer.when():
            self._cancel_timer()
            self._timer = self._loop.call_at(at, self._look)

    def _look(self) -> None:
        self._timer = None
        if self.error is None:
            self._tick()
        elif self._loop.time() >= self._cut_at:
            self.transport.abort()
        else:
            self._look_within(self._cut_at - self._loop.time())

    def _tick(self) -> None:
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
