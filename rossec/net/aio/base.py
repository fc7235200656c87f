"""What every stream on a loop has: received units, waiting for a change, back-pressure both ways.

Reading pauses while the consumer lags, writers wait while the peer does. A unit is whatever the
stream delivers: `SecureStream` what was sent together, the sidecar's `PlainStream` what arrived. It
is a base class, since a second object would cost a call for each unit.
"""

import asyncio
from collections import deque
from collections.abc import Awaitable, Callable
from typing import Final, NoReturn

from rossec.channel.records import Bytes
from rossec.errors import ChannelError
from rossec.net.aio.transport import ByteTransport

_PAUSE_ABOVE: Final = 1024 * 1024  # bytes delivered and not taken


class BaseStream:
    """Units received and not taken, and the waiters for a change of the connection.

    A subclass calls `_deliver` and then `_notify`, sets `error` at the end, and wakes the waiters.
    """

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
        """Raise the error that ended the connection, if it has ended: a copy, as it is kept."""
        if self.error is not None:
            raise self.error.bare()

    def _deliver(self, unit: Bytes) -> None:
        """Pass the unit on at once while forwarding; queue it otherwise, a copy of a view."""
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
        """Return the next unit.

        Raises:
            ChannelClosed: the connection was closed in order.
            ChannelError: it ended in another way; the class says how.
        """
        while (unit := self.next_unit()) is None:
            await self._changed()
        return unit

    def on_ready(
        self, callback: Callable[[], None] | None, take: Callable[[bytes], bool] | None = None
    ) -> None:
        """Call back whenever `next_unit` has a new result: instead of `receive`.

        A unit that arrived alone may be offered to `take` first; if it returns true, it is not
        queued. Neither may raise.
        """
        self._callback, self._take = callback, take

    @property
    def has_unit(self) -> bool:
        """Whether `next_unit` would return a unit."""
        return self._units is not None

    def next_unit(self) -> bytes | None:
        """Return the next unit if it has arrived.

        Raises:
            ChannelError: as `receive`.
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

    def _notify(self) -> None:
        """Units were queued or the connection ended; pause reading above the limit."""
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

        Raises:
            ChannelError: the connection has ended; or what `write_nowait` or `drain` raise.
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
                if self._forward_error is not None:
                    self._raise_forward_error()
                await drain()
        finally:
            self._write_nowait = None

    def _raise_forward_error(self) -> None:
        """Raise it once: kept here it would be part of a cycle with the frames it names."""
        error, self._forward_error = self._forward_error, None
        try:
            if error is not None:
                raise error
        finally:
            del error

    def _is_forwarding(self) -> bool:
        return self._write_nowait is not None and self.error is None

    def _changed(self) -> asyncio.Future[None]:
        """A future for the next change of any kind; the caller checks which."""
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
        """Bytes that were written and not sent yet."""
        return self.transport.backlog

    async def drain(self) -> None:
        """Wait until the peer caught up.

        Raises:
            ChannelError: the connection ended meanwhile.
        """
        if not self.transport.writable:
            while self.transport.backlog > 0 and self.error is None:
                await self._changed()
        self.check()

    async def flushed(self) -> None:
        """Wait until everything written was taken by what carries it.

        Raises:
            ChannelError: the connection ended meanwhile.
        """
        while self.transport.backlog > 0 and self.error is None:
            await self._changed()
        self.check()

    async def wait_ended(self) -> None:
        """Return when the connection has ended; takes no unit."""
        while self.error is None:
            await self._changed()
