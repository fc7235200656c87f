"""A plain TCP connection with a program of this host: bytes as they come, with back-pressure.

It has the methods of a secure stream, so that both kinds of end can be served and pumped alike.
Its buffer is small until a program fills it: fifty quiet nodes must not cost fifty large buffers.
"""

import asyncio
import socket
from collections.abc import Awaitable, Callable
from typing import Final, NoReturn

from rossec.channel.records import Bytes
from rossec.errors import ChannelClosed
from rossec.net.aio.transport import Transport

_SMALL: Final = 8 * 1024
_LARGE: Final = 512 * 1024  # two records of the channel: what its other end reads at a time
_LINGER: Final = 2.0


class PlainStream:
    """One connection; `peer` says who it is as far as anybody knows: a program of this host."""

    peer = "a program of this host"

    def __init__(self, sock: socket.socket) -> None:
        self._buffer = memoryview(bytearray(_SMALL))
        self._end = 0
        self._ended = False
        self._write_nowait: Callable[[memoryview], bool] | None = None
        self._forward_error: BaseException | None = None
        self._waiting: asyncio.Future[None] | None = None
        self._callback: Callable[[], None] | None = None
        self._drained = asyncio.Event()
        self._lost = asyncio.Event()
        self._transport = Transport(sock, self)
        self._transport.resume_reading()

    # -- called by the transport

    def get_buffer(self) -> memoryview:
        """The free tail of the buffer."""
        return self._buffer[self._end :]

    def buffer_updated(self, count: int) -> None:
        """Pass the bytes on, or keep them until they are taken; without room stop reading."""
        self._end += count
        if self._write_nowait is not None:
            self._pass_on(self._write_nowait)
            return
        if self._end == len(self._buffer):
            self._transport.pause_reading()
        self._wake()

    def _pass_on(self, write_nowait: Callable[[memoryview], bool]) -> None:
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
            self._wake()

    def eof_received(self) -> None:
        """The program sends nothing more."""
        self._ended = True
        self._wake()

    def resume_writing(self) -> None:
        """The program caught up."""
        self._drained.set()

    def connection_lost(self) -> None:
        """The connection is closed."""
        self._ended = True
        self._lost.set()
        self._drained.set()
        self._wake()

    # -- for users

    async def take(self) -> memoryview:
        """What has arrived, at least one byte; valid until `taken`.

        Raises:
            ChannelClosed: the program sends nothing more.
        """
        while self._end == 0:
            if self._ended:
                raise ChannelClosed("the program closed the connection")
            self._waiting = asyncio.get_running_loop().create_future()
            await self._waiting
        return self._buffer[: self._end]

    def taken(self, view: memoryview) -> None:
        """Give back what `take` lent; what came meanwhile moves to the front."""
        count, full = len(view), self._end == len(self._buffer)
        rest = self._end - count
        if full and len(self._buffer) < _LARGE:
            larger = memoryview(bytearray(_LARGE))
            larger[:rest] = self._buffer[count : self._end]
            self._buffer = larger
        elif rest:
            self._buffer[:rest] = bytes(self._buffer[count : self._end])
        self._end = rest
        if full and not self._ended:
            self._transport.resume_reading()

    async def forward(
        self, write_nowait: Callable[[memoryview], bool], drain: Callable[[], Awaitable[None]]
    ) -> NoReturn:
        """Pass what arrives to `write_nowait` at once, without a turn of the loop for it.

        When `write_nowait` says no, nothing more is read until `drain` returns.

        Raises:
            ChannelClosed: no more bytes; or what `write_nowait` or `drain` raise.
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
                await self._stalled()
                if self._forward_error is not None:
                    raise self._forward_error
        finally:
            self._write_nowait = None

    async def _stalled(self) -> None:
        """Wait until the receiver lags, or the program ends."""
        while self._write_nowait is not None and not self._ended:
            self._waiting = asyncio.get_running_loop().create_future()
            await self._waiting

    def on_ready(
        self,
        callback: Callable[[], None] | None,
        take: Callable[[bytes], bool] | None = None,  # noqa: ARG002 - what arrives is always kept
    ) -> None:
        """Whom to call whenever `next_unit` has something new to say, as of `SecureStream`."""
        self._callback = callback

    @property
    def has_unit(self) -> bool:
        """Whether `next_unit` would return something."""
        return self._end > 0

    def next_unit(self) -> bytes | None:
        """What has arrived, copied; None: nothing yet.

        Raises:
            ChannelClosed: the program sends nothing more.
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
        """Send, unless the program lags; whether it did.

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
            ChannelClosed: the program sends nothing more.
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
        """Wait until the program caught up."""
        while not self._transport.writable:
            self._drained.clear()
            await self._drained.wait()

    async def close(self) -> None:
        """End this side after what was sent; wait for the other, but not for long."""
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

    def _wake(self) -> None:
        if self._waiting is not None and not self._waiting.done():
            self._waiting.set_result(None)
        if self._callback is not None:
            self._callback()
