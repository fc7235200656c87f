"""The connections of a sidecar with programs of its host, and the loopback ports that accept them."""

import asyncio
import socket
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Final

from rossec.channel.records import Bytes
from rossec.errors import ChannelClosed
from rossec.host.local_ports import LocalPort, PortAdmission
from rossec.net.aio.transport import BaseStream, Transport

_SMALL: Final = 8 * 1024
_LARGE: Final = 512 * 1024  # two records of the channel: what a peer reads at a time
_LINGER: Final = 2.0
_CLOSED: Final = "the program closed the connection"


class PlainStream(BaseStream):
    """A plain TCP connection with a program of this host: bytes as they come, with back-pressure.

    It has the methods of `SecureStream`, so that both kinds can be served and forwarded alike.
    """

    peer = "a program of this host"

    def __init__(self, sock: socket.socket) -> None:
        super().__init__()
        self.socket: Final = sock  # by which the kernel says whose the other end is
        self._buffer = memoryview(bytearray(_SMALL))
        self.transport = Transport(sock, self)
        self.transport.resume_reading()

    # -- called by the transport

    def get_buffer(self) -> memoryview:
        return self._buffer

    def buffer_updated(self, count: int) -> None:
        self._deliver(self._buffer[:count])
        # Small until a program fills it: fifty idle nodes must not cost fifty large buffers.
        if count == len(self._buffer) < _LARGE:
            self._buffer = memoryview(bytearray(_LARGE))
        if self._units:
            self._notify()

    def eof_received(self) -> None:
        self.error = ChannelClosed(_CLOSED)
        self._notify()

    def resume_writing(self) -> None:
        self._wake_waiters()

    def connection_lost(self) -> None:
        self.eof_received()

    # -- for users

    def write_nowait(self, data: Bytes) -> bool:
        if self.transport.closed:
            raise ChannelClosed(_CLOSED)
        self.transport.write(data)
        return self.transport.writable

    async def send(self, *pieces: Bytes) -> None:
        for piece in pieces:
            self.write_nowait(piece)
        await self.drain()

    async def close(self) -> None:
        self.transport.write_eof()
        try:
            with suppress(ChannelClosed, TimeoutError):
                async with asyncio.timeout(_LINGER):
                    while True:
                        await self.receive()
        finally:
            self.transport.abort()

    def abort(self, _reason: str = "") -> None:
        self.transport.abort()


Handler = Callable[[PlainStream], Awaitable[None]]


class LoopbackPort(LocalPort):
    def __init__(self, callers: PortAdmission, handler: Handler, port: int = 0) -> None:
        async def attend(sock: socket.socket) -> None:
            stream = PlainStream(sock)
            try:
                await handler(stream)
            finally:
                stream.abort()

        super().__init__(callers, attend, port)
