"""One non-blocking socket on a loop, and what every stream over one has: received units, back-pressure.

Not an asyncio transport: those copy what the kernel does not take at once, twice for a large record, and cost
more calls per message. Here a remainder is copied once, and the socket is read straight into the owner's
buffer. A unit is whatever the stream delivers: `SecureStream` what was sent together, the sidecar's
`PlainStream` what arrived.
"""

import asyncio
import socket
import struct
from collections import deque
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Final, NoReturn, Protocol

from rossec.channel.records import Bytes
from rossec.channel.tuning import HIGH_WATER, UNSENT
from rossec.errors import ChannelError

_RESET_ON_CLOSE: Final = struct.pack("ii", 1, 0)
_PAUSE_ABOVE: Final = 1024 * 1024  # bytes delivered and not taken


class TransportOwner(Protocol):
    """Receives the events of the socket; names as in `asyncio.BufferedProtocol`."""

    def get_buffer(self) -> memoryview:
        """The buffer for the next bytes; raises BlockingIOError: no room, the owner has paused reading."""

    def buffer_updated(self, count: int) -> None: ...
    def eof_received(self) -> bool | None: ...
    def resume_writing(self) -> None: ...

    def connection_lost(self) -> None:
        """The socket is closed; called once, never from within a call of this class."""


class ByteTransport(Protocol):
    """What carries the bytes of one connection: `Transport`, or a link between sites."""

    @property
    def backlog(self) -> int: ...
    @property
    def closed(self) -> bool: ...

    # This side's IP address, as the peer sees it unless there is NAT between; or empty.
    @property
    def local_address(self) -> str: ...
    @property
    def writable(self) -> bool: ...
    @property
    def reading(self) -> bool: ...
    def resume_reading(self) -> None: ...
    def pause_reading(self) -> None: ...
    def write(self, data: Bytes) -> None: ...
    def limit_unsent(self) -> None: ...
    def write_eof(self) -> None: ...
    def finish(self) -> None: ...
    def disconnect(self) -> None: ...
    def abort(self) -> None: ...


class Transport:
    """The socket of one connection; it owns the socket from the beginning."""

    __slots__ = (
        "_closing",
        "_eof_due",
        "_fd",
        "_loop",
        "_owner",
        "_pending",
        "_socket",
        "backlog",
        "closed",
        "reading",
    )

    def __init__(self, sock: socket.socket, owner: TransportOwner) -> None:
        sock.setblocking(False)
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket = sock
        self._fd = sock.fileno()
        self._owner = owner
        self._loop = asyncio.get_running_loop()
        self._pending: deque[memoryview] | None = None  # None: an empty one has its price
        self.backlog = 0
        self.closed = False
        self._closing = self._eof_due = self.reading = False

    @property
    def local_address(self) -> str:
        try:
            host: str = self._socket.getsockname()[0]
        except OSError:
            return ""
        return host

    @property
    def writable(self) -> bool:
        return self.backlog <= HIGH_WATER

    # -- reading

    def resume_reading(self) -> None:
        if not (self.reading or self._closing or self.closed):
            self.reading = True
            self._loop.add_reader(self._fd, self._readable)

    def pause_reading(self) -> None:
        """Leave arriving bytes in the kernel, whose flow control slows the peer."""
        if self.reading:
            self.reading = False
            self._loop.remove_reader(self._fd)

    def read_now(self) -> None:
        """Read what has arrived, once, in the caller's turn and not in the loop's."""
        if not (self._closing or self.closed):
            self._read()

    def _readable(self) -> None:
        if self._read() and self._eof_due and not self.closed:
            self._read()  # the peer's answer and its FIN mostly arrive together

    def _read(self) -> bool:
        try:
            count = self._socket.recv_into(self._owner.get_buffer())
        except (BlockingIOError, InterruptedError):
            return False
        except OSError:
            self.abort()
            return False
        if count > 0:
            try:
                self._owner.buffer_updated(count)
            except BaseException:  # a bug, perhaps in a guard: nothing more passes
                self.abort()
                raise
            return True
        self.pause_reading()
        self._closing = True
        if self._owner.eof_received():
            self._closing = False
        elif not self._pending:
            self.abort()
        return False

    # -- writing

    def write(self, data: Bytes) -> None:
        """Send `data`, which may change afterwards: what does not fit now is copied, sent later."""
        if self.closed:
            return
        sent = 0
        if self._pending is None:
            sent = self._send(data)
            if sent == len(data) or self.closed:
                return
            self._loop.add_writer(self._fd, self._flush)
            self._pending = deque()
        self._pending.append(memoryview(bytes(memoryview(data)[sent:])))
        self.backlog += len(data) - sent

    def _send(self, data: Bytes) -> int:
        try:
            return self._socket.send(data)
        except (BlockingIOError, InterruptedError):
            return 0
        except OSError:  # the peer is gone
            self.abort()
            return 0

    def _flush(self) -> None:
        pending = self._pending
        while pending:
            sent = self._send(pending[0])
            if self.closed:
                return
            self.backlog -= sent
            if sent < len(pending[0]):
                pending[0] = pending[0][sent:]
                return
            pending.popleft()
        self._pending = None
        self._loop.remove_writer(self._fd)
        if self._eof_due:
            self._shut()
        if self._closing:
            self.abort()
        else:
            self._owner.resume_writing()

    def limit_unsent(self) -> None:
        with suppress(OSError):
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, UNSENT)

    # -- ends

    def write_eof(self) -> None:
        """End this side's stream after what was written."""
        self._eof_due = True
        if not self._pending and not self.closed:
            self._shut()

    def finish(self) -> None:
        """Close the socket once everything is written: both sides have closed."""
        self.pause_reading()
        self._closing = True
        if not self._pending:
            self.abort()

    def _shut(self) -> None:
        with suppress(OSError):  # the peer may have reset the connection already
            self._socket.shutdown(socket.SHUT_WR)

    def reset(self) -> None:
        """Abort, so that the peer sees a broken connection and no end."""
        if not self.closed:
            with suppress(OSError):
                self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET_ON_CLOSE)
            self.abort()

    def disconnect(self) -> None:
        """Let nothing pass any more, before `abort`: of many connections each takes half as long so."""
        self.pause_reading()  # the kernel would still return what had arrived
        self._closing = True
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)

    def abort(self) -> None:
        """Close the socket now; what was not sent is dropped."""
        if self.closed:
            return
        self.closed = True
        self.pause_reading()
        if self._pending:
            self._loop.remove_writer(self._fd)
            self._pending = None
            self.backlog = 0
        self._socket.close()
        self._loop.call_soon(self._owner.connection_lost)
        del self._owner  # no reference cycle with the owner


class BaseStream:
    """Units received and not taken, and the waiters for a change of the connection.

    Reading pauses while the consumer lags, writers wait while the peer does. A base class, since a second
    object would cost a call for each unit. A subclass calls `_deliver` and then `_notify`, sets `error` at
    the end, and wakes the waiters.
    """

    # Above 30 attributes each object's dict costs 1.6 kB.
    __slots__ = (
        "_callback",
        "_forward_error",
        "_loop",
        "_take",
        "_units",
        "_unread",
        "_waiters",
        "_write_nowait",
        "error",
        "transport",
    )
    transport: ByteTransport

    def __init__(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._units: deque[bytes] | None = None  # None: an empty one costs memory
        self._unread = 0
        self._write_nowait: Callable[[Bytes], bool] | None = None
        self._forward_error: BaseException | None = None
        self._waiters: list[asyncio.Future[None]] = []
        self._callback: Callable[[], None] | None = None
        self._take: Callable[[bytes], bool] | None = None
        self.error: ChannelError | None = None

    def check(self) -> None:
        if self.error is not None:
            raise self.error.bare()

    def _deliver(self, unit: Bytes) -> None:
        # Pass the unit on at once while forwarding; queue it otherwise, a copy of a view.
        write_nowait = self._write_nowait
        if write_nowait is None:
            if self._units is None:
                self._units = deque()
            self._units.append(bytes(unit))
            self._unread += len(unit)
            return
        try:
            lags = not write_nowait(unit)
        except BaseException as error:  # noqa: BLE001 - raised in `forward`
            self._forward_error, lags = error, True
        if lags:
            self._write_nowait = None
            self.transport.pause_reading()
            self._wake_waiters()

    # -- receiving

    async def receive(self) -> bytes:
        """Return the next unit."""
        while (unit := self.next_unit()) is None:
            await self._changed()
        return unit

    def on_ready(
        self, callback: Callable[[], None] | None, take: Callable[[bytes], bool] | None = None
    ) -> None:
        """Call back whenever `next_unit` has a new result: instead of `receive`. A unit that arrived alone
        may be offered to `take` first; if it returns true, it is not queued. Neither may raise."""
        self._callback, self._take = callback, take

    @property
    def has_unit(self) -> bool:
        return self._units is not None

    def next_unit(self) -> bytes | None:
        """Return the next unit if it has arrived; raises ChannelError: as `receive`."""
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

    def _notify(self) -> None:
        if self._callback is not None:
            self._callback()
        if self._waiters:
            self._wake_waiters()
        if self._unread > _PAUSE_ABOVE and self.error is None:
            self.transport.pause_reading()

    async def forward(
        self, write_nowait: Callable[[Bytes], bool], drain: Callable[[], Awaitable[None]]
    ) -> NoReturn:
        """Pass each unit to `write_nowait` as it arrives, without another turn of the loop.

        When it returns false, nothing more is read until `drain` returns.
        """
        try:
            while True:
                while self._units:
                    write_nowait(await self.receive())
                    await drain()
                self.check()
                self.transport.resume_reading()
                self._write_nowait = write_nowait
                while self._is_forwarding():
                    await self._changed()
                # Raise it once: kept here it would be part of a cycle with the frames it names.
                error, self._forward_error = self._forward_error, None
                try:
                    if error is not None:
                        raise error
                finally:
                    del error
                await drain()
        finally:
            self._write_nowait = None

    def _is_forwarding(self) -> bool:  # a method: it changes while `_changed` is awaited
        return self._write_nowait is not None and self.error is None

    def _changed(self) -> asyncio.Future[None]:
        waiter = self._loop.create_future()
        self._waiters.append(waiter)
        return waiter

    def _wake_waiters(self) -> None:
        waiting, self._waiters = self._waiters, []
        for waiter in waiting:
            if not waiter.done():
                waiter.set_result(None)

    # -- sending

    @property
    def lags(self) -> bool:
        """Whether the peer does: further writes would be buffered here."""
        return not self.transport.writable

    @property
    def backlog(self) -> int:
        return self.transport.backlog

    async def drain(self) -> None:
        """Wait until the peer caught up; raises ChannelError: the connection ended meanwhile."""
        if self.transport.writable:
            self.check()
        else:
            await self.flushed()

    async def flushed(self) -> None:
        """Wait until everything written was taken by what carries it; raises as `drain`."""
        while self.transport.backlog > 0 and self.error is None:
            await self._changed()
        self.check()

    async def wait_ended(self) -> None:
        while self.error is None:
            await self._changed()
