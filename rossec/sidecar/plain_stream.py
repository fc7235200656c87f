"""A plain TCP connection with a program of this host: bytes as they come, with back-pressure.

It has the methods of `SecureStream`, so that both kinds can be served and forwarded alike. Its
buffer is small until a program fills it: fifty idle nodes must not cost fifty large buffers.
"""

import asyncio
import socket
from collections.abc import Awaitable, Callable
from typing import Final, NoReturn

from rossec.channel.records import Bytes
from rossec.errors import ChannelClosed
from rossec.net.aio.transport import Transport

_SMALL: Final = 8 * 1024
_LARGE: Final = 512 * 1024  # two records of the channel: what a peer reads at a time
_LINGER: Final = 2.0


class PlainStream:
    """One connection; `peer` is a constant: a program has no identity of its own."""

    peer = "a program of this host"

    def __init__(self, sock: socket.socket) -> None:
        self._buffer = memoryview(bytearray(_SMALL))
        self._end = 0
        self._ended = False
        self._write_nowait: Callable[[memoryview], bool] | None = None
        self._forward_error: BaseException | None = None
        self._waiter: asyncio.Future[None] | None = None
        self._callback: Callable[[], None] | None = None
        self._drained = asyncio.Event()
        self._transport = Transport(sock, self)
        self._transport.resume_reading()

    # -- called by the transport

    def get_buffer(self) -> memoryview:
        """The free tail of the buffer."""
        return self._buffer[self._end :]

    def buffer_updated(self, count: int) -> None:
        """Forward the bytes, or buffer them; if the buffer is full, pause reading."""
        self._end += count
        if self._write_nowait is not None:
            self._write_received(self._write_nowait)
            return
        if self._end == len(self._buffer):
            self._transport.pause_reading()
        self._notify()

    def _write_received(self, write_nowait: Callable[[memoryview], bool]) -> None:
        view = self._buffer[: self._end]
        self._end = 0
        try:
            lags = not write_nowait(view)
        except BaseException as error:  # noqa: BLE001 - raised where it belongs, in `forward`
            self._forward_error, lags = error, True
        if len(view) == len(self._buffer) < _LARGE:
            self._buffer = memoryview(bytearray(_LARGE))
        if lags:
            self._write_nowait = None
            self._transport.pause_reading()
            self._notify()

    def eof_received(self) -> None:
        """The program has closed its side."""
        self._ended = True
        self._notify()

    def resume_writing(self) -> None:
        """Everything written was sent."""
        self._drained.set()

    def connection_lost(self) -> None:
        """The connection is closed."""
        self._ended = True
        self._drained.set()
        self._notify()

    # -- for users

    async def take(self) -> memoryview:
        """The received bytes, at least one; valid until `taken`.

        Raises:
            ChannelClosed: the program has closed its side.
        """
        while self._end == 0:
            if self._ended:
                raise ChannelClosed("the program closed the connection")
            self._waiter = asyncio.get_running_loop().create_future()
            await self._waiter
        return self._buffer[: self._end]

    def taken(self, view: memoryview) -> None:
        """Release the view from `take`; bytes received since move to the front."""
        count, full = len(view), self._end == len(self._buffer)
        remaining = self._end - count
        if full and len(self._buffer) < _LARGE:
            larger = memoryview(bytearray(_LARGE))
            larger[:remaining] = self._buffer[count : self._end]
            self._buffer = larger
        elif remaining:
            self._buffer[:remaining] = bytes(self._buffer[count : self._end])
        self._end = remaining
        if full and not self._ended:
            self._transport.resume_reading()

    async def forward(
        self, write_nowait: Callable[[memoryview], bool], drain: Callable[[], Awaitable[None]]
    ) -> NoReturn:
        """Pass received bytes to `write_nowait` directly, without a task switch.

        When `write_nowait` returns false, reading pauses until `drain` returns.

        Raises:
            ChannelClosed: the program has closed its side; or what `write_nowait` or `drain` raise.
        """
        try:
            while True:
                await drain()
                if self._end > 0 or self._ended:  # what came before, or meanwhile
                    view = await self.take()
                    write_nowait(view)
                    self.taken(view)
                    continue
                self._write_nowait = write_nowait
                self._transport.resume_reading()
                await self._until_blocked()
                if self._forward_error is not None:
                    raise self._forward_error
        finally:
            self._write_nowait = None

    async def _until_blocked(self) -> None:
        """Wait until the receiver lags, or the program closes."""
        while self._write_nowait is not None and not self._ended:
            self._waiter = asyncio.get_running_loop().create_future()
            await self._waiter

    def on_ready(
        self,
        callback: Callable[[], None] | None,
        take: Callable[[bytes], bool] | None = None,  # noqa: ARG002 - data is always buffered
    ) -> None:
        """Set the callback for new data or the end, as of `SecureStream`."""
        self._callback = callback

    @property
    def has_unit(self) -> bool:
        """Whether `next_unit` would return something."""
        return self._end > 0

    def next_unit(self) -> bytes | None:
        """The received bytes, copied; None: nothing yet.

        Raises:
            ChannelClosed: the program has closed its side.
        """
        if self._end == 0:
            if self._ended:
                raise ChannelClosed("the program closed the connection")
            return None
        view = self._buffer[: self._end]
        data = bytes(view)
        self.taken(view)
        return data

    def try_send(self, unit: bytes) -> bool:
        """Send, unless the program lags; returns whether it was sent.

        Raises:
            ChannelClosed: the connection is closed.
        """
        if self._transport.closed:
            raise ChannelClosed("the program closed the connection")
        writable = self._transport.writable
        if writable:
            self._transport.write(unit)
        return writable

    async def receive(self) -> bytes:
        """The next bytes, copied.

        Raises:
            ChannelClosed: the program has closed its side.
        """
        view = await self.take()
        data = bytes(view)
        self.taken(view)
        return data

    def write_nowait(self, data: Bytes) -> bool:
        """Send `data` now, whether the program lags or not; false: it does, wait for `drain`.

        Raises:
            ChannelClosed: the connection is closed.
        """
        if self._transport.closed:
            raise ChannelClosed("the program closed the connection")
        self._transport.write(data)
        return self._transport.writable

    async def send(self, *pieces: Bytes) -> None:
        """Send the pieces; waits while the program lags.

        Raises:
            ChannelClosed: the connection is closed.
        """
        for piece in pieces:
            self.write_nowait(piece)
        await self.drain()

    async def drain(self) -> None:
        """Wait until the program has caught up."""
        while not self._transport.writable:
            self._drained.clear()
            await self._drained.wait()

    async def close(self) -> None:
        """Close this side after what was sent; wait briefly for the other."""
        self._transport.write_eof()
        try:
            async with asyncio.timeout(_LINGER):
                while not self._ended:
                    self.taken(await self.take())
        except (ChannelClosed, TimeoutError):
            pass
        finally:
            self._transport.abort()

    def abort(self, _reason: str = "") -> None:
        """Drop the connection at once."""
        self._transport.abort()

    def _notify(self) -> None:
        if self._waiter is not None and not self._waiter.done():
            self._waiter.set_result(None)
        if self._callback is not None:
            self._callback()
