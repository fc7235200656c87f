"""The receiving half of a connection on a loop: its units, until somebody takes or forwards them.

Reading pauses while the consumer lags. `Driver` adds the rest; a base class, as a call from one
object to another for each unit would cost.
"""

import asyncio
from collections import deque
from collections.abc import Awaitable, Callable
from copy import copy
from typing import Final, NoReturn

from rossec.errors import ChannelError
from rossec.net.aio.transport import Transport

_PAUSE_ABOVE: Final = 1024 * 1024  # bytes delivered and not taken


class ReceiveQueue:
    """Units received and not taken, and who waits for the next change of the connection."""

    transport: Transport

    def __init__(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._units: deque[bytes] | None = None  # None: an empty one has its price
        self._unread = 0
        self._write_nowait: Callable[[bytes], bool] | None = None
        self._forward_error: BaseException | None = None
        self._waiters: list[asyncio.Future[None]] = []
        self.on_ready: Callable[[], None] | None = None
        self.error: ChannelError | None = None

    def check(self) -> None:
        """Raise what ended the connection, if something did.

        A copy: with its traceback the one kept here would keep alive whatever it was raised in.
        """
        if self.error is not None:
            raise copy(self.error)

    def _deliver(self, unit: bytes) -> None:
        """Pass the unit on at once if somebody pours; keep it otherwise."""
        write_nowait = self._write_nowait
        if write_nowait is None:
            if self._units is None:
                self._units = deque()
            self._units.append(unit)
            self._unread += len(unit)
            return
        try:
            lags = not write_nowait(unit)
        except BaseException as error:  # noqa: BLE001 - raised where it belongs, in `forward`
            self._forward_error, lags = error, True
        if lags:
            self._write_nowait = None
            self.transport.pause_reading()
            self._wake_waiters()

    async def receive(self) -> bytes:
        """Return the next unit.

        Raises:
            ChannelError: there will be none.
        """
        while (unit := self.take()) is None:
            await self._changed()
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

    def _notify(self) -> None:
        """There is something to take, or there will never be; pause reading if it is too much."""
        if self.on_ready is not None:
            self.on_ready()
        if self._waiters:
            self._wake_waiters()
        if self._unread > _PAUSE_ABOVE and self.error is None:
            self.transport.pause_reading()

    async def forward(
        self, write_nowait: Callable[[bytes], bool], drain: Callable[[], Awaitable[None]]
    ) -> NoReturn:
        """Pass each unit to `write_nowait` as it arrives, without a turn of the loop for it.

        When `write_nowait` says no, nothing more is read until `drain` returns.

        Raises:
            ChannelError: there will be no more units; or whatever `write_nowait` or `drain` raise.
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
                    raise self._forward_error
                await drain()
        finally:
            self._write_nowait = None

    def _is_forwarding(self) -> bool:
        return self._write_nowait is not None and self.error is None

    def _changed(self) -> asyncio.Future[None]:
        """What to await until anything happens; the caller looks whether it was for it."""
        waiter = self._loop.create_future()
        self._waiters.append(waiter)
        return waiter

    def _wake_waiters(self) -> None:
        waiting, self._waiters = self._waiters, []
        for waiter in waiting:
            if not waiter.done():
                waiter.set_result(None)

    async def drain(self) -> None:
        """Wait until the peer caught up.

        Raises:
            ChannelError: the connection ended meanwhile.
        """
        if not self.transport.writable:
            while self.transport.backlog > 0 and self.error is None:
                await self._changed()
        self.check()

    async def wait_ended(self) -> None:
        """Return when the connection is at its end."""
        while self.error is None:
            await self._changed()
