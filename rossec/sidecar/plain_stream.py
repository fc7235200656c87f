"""A plain TCP connection with a program of this host: bytes as they come, with back-pressure.

It has the methods of `SecureStream`, so that both kinds can be served and forwarded alike. Its
buffer is small until a program fills it: fifty idle nodes must not cost fifty large buffers.
"""

import asyncio
import socket
from contextlib import suppress
from typing import Final

from rossec.channel.records import Bytes
from rossec.errors import ChannelClosed
from rossec.net.aio.base import BaseStream
from rossec.net.aio.transport import Transport

_SMALL: Final = 8 * 1024
_LARGE: Final = 512 * 1024  # two records of the channel: what a peer reads at a time
_LINGER: Final = 2.0
_CLOSED: Final = "the program closed the connection"


class PlainStream(BaseStream):
    """One connection; `peer` is a constant: a program has no identity of its own.

    Attributes:
        socket: by which the kernel says whose the other end is.
    """

    peer = "a program of this host"

    def __init__(self, sock: socket.socket) -> None:
        super().__init__()
        self.socket: Final = sock
        self._buffer = memoryview(bytearray(_SMALL))
        self.transport = Transport(sock, self)
        self.transport.resume_reading()

    # -- called by the transport

    def get_buffer(self) -> memoryview:
        """The buffer; what it had was forwarded or copied."""
        return self._buffer

    def buffer_updated(self, count: int) -> None:
        """Forward the bytes without a copy, or queue them."""
        self._deliver(self._buffer[:count])
        if count == len(self._buffer) < _LARGE:
            self._buffer = memoryview(bytearray(_LARGE))
        if self._units:
            self._notify()

    def eof_received(self) -> None:
        """The program has closed its side."""
        self.error = ChannelClosed(_CLOSED)
        self._notify()

    def resume_writing(self) -> None:
        """Everything written was sent."""
        self._wake_waiters()

    def connection_lost(self) -> None:
        """The connection is closed."""
        self.eof_received()

    # -- for users

    def write_nowait(self, data: Bytes) -> bool:
        """Send `data` now, whether the program lags or not; false: it does, wait for `drain`.

        Raises:
            ChannelClosed: the connection is closed.
        """
        if self.transport.closed:
            raise ChannelClosed(_CLOSED)
        self.transport.write(data)
        return self.transport.writable

    async def send(self, *pieces: Bytes) -> None:
        """Send the pieces; waits while the program lags.

        Raises:
            ChannelClosed: the connection is closed.
        """
        for piece in pieces:
            self.write_nowait(piece)
        await self.drain()

    async def close(self) -> None:
        """Close this side after what was sent; wait briefly for the other."""
        self.transport.write_eof()
        try:
            with suppress(ChannelClosed, TimeoutError):
                async with asyncio.timeout(_LINGER):
                    while True:
                        await self.receive()
        finally:
            self.transport.abort()

    def abort(self, _reason: str = "") -> None:
        """Drop the connection at once."""
        self.transport.abort()
