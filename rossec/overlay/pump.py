"""One TCP connection of this site and its stream of a link: bytes both ways, ends as ends.

No queue: the socket is read when the stream has credit and the link has room, straight into the
buffer from which the unit is sealed. Bytes for a program that lags wait here, no more of them than
the credit given. An end is passed on as an end, a broken connection as a broken one.
"""

import asyncio
import socket
from collections.abc import Callable
from typing import Final, Protocol, TypeVar

from rossec.channel.records import Bytes
from rossec.errors import StreamRefused
from rossec.net.aio.transport import Transport

_KEEPALIVE: Final = (
    (socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1),
    (socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, 60),  # a host that vanished must not hold a stream
    (socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, 15),
)
Found = TypeVar("Found")


class StreamEnd(Protocol):
    """What a pump needs of its stream, by the stream's number."""

    def buffer_for(self, stream: int) -> memoryview | None:
        """Where to read bytes for the stream; None: not now, `Pump.resume` says when."""

    def send(self, stream: int, count: int) -> None:
        """Send what is in that buffer."""

    def took(self, stream: int, count: int) -> None:
        """The program took so many received bytes."""

    def end(self, stream: int) -> bool:
        """The program sends nothing more; whether it still receives."""

    def reset(self, stream: int) -> None:
        """The connection is broken, or closed."""


class Pump:
    """The connection; without a socket until `connect`. `over` is set when it is closed."""

    def __init__(self, stream: int, end: StreamEnd) -> None:
        self._stream = stream
        self._end = end
        self._transport: Transport | None = None
        self._early = bytearray()  # what arrived before there was a socket
        self._early_end = False
        self._read_all = False  # the program sends nothing more
        self._changed = asyncio.Event()
        self._held = 0  # received bytes the program has not taken
        self.over: Final = asyncio.Event()

    @property
    def connected(self) -> bool:
        """Whether there was a socket."""
        return self._transport is not None

    def connect(self, sock: socket.socket) -> None:
        """Use this socket from now on; owns it."""
        if self.over.is_set():
            sock.close()
            return
        for option in _KEEPALIVE:
            sock.setsockopt(*option)
        self._transport = Transport(sock, self)
        early, self._early = self._early, bytearray()
        if early:
            self._write(early)
        if self._early_end:
            self._transport.write_eof()
        self._transport.resume_reading()

    async def first_bytes(self, decide: Callable[[bytes], Found | None]) -> Found:
        """What `decide` says of the first bytes of the stream; None: it needs more of them.

        Raises:
            StreamRefused: the stream ended before; or what `decide` raises.
        """
        while (found := decide(bytes(self._early))) is None:
            if self._early_end or self.over.is_set():
                raise StreamRefused("a stream that ended before it said anything")
            self._changed.clear()
            await self._changed.wait()
        return found

    # -- called for the stream

    def arrived(self, payload: Bytes) -> None:
        """Bytes of the stream."""
        self._held += len(payload)
        if self._transport is None:
            self._early += payload
            self._changed.set()
        else:
            self._write(payload)

    def _write(self, payload: Bytes) -> None:
        transport = self._transport
        if transport is not None:
            transport.write(payload)
            self._account(transport)

    def _account(self, transport: Transport) -> None:
        taken = self._held - transport.backlog
        if taken > 0:
            self._held -= taken
            self._end.took(self._stream, taken)

    def ended(self, *, over: bool) -> None:
        """The other side sends nothing more; `over`: this side neither."""
        self._early_end = True
        self._changed.set()
        if self._transport is not None:
            self._transport.write_eof()
            if over:
                self._transport.finish()

    def resume(self) -> None:
        """There is credit, or room in the link: read on, at once and then as bytes arrive."""
        if self._transport is not None and not self._read_all:
            self._transport.resume_reading()
            self._transport.read_now()

    def break_off(self) -> None:
        """The stream is broken off: so is the connection."""
        if self._transport is None:
            self.connection_lost()
        else:
            self._transport.reset()

    # -- called by the transport

    def get_buffer(self) -> memoryview:
        """The link's buffer, as far as the credit goes."""
        buffer = self._end.buffer_for(self._stream)
        if buffer is None:
            if self._transport is not None:
                self._transport.pause_reading()
            raise BlockingIOError
        return buffer

    def buffer_updated(self, count: int) -> None:
        """Send what was read."""
        self._end.send(self._stream, count)

    def eof_received(self) -> bool:
        """Pass the end on; the socket stays open while the other direction is."""
        self._read_all = True
        return self._end.end(self._stream)

    def resume_writing(self) -> None:
        """The program took everything."""
        if self._transport is not None:
            self._account(self._transport)

    def connection_lost(self) -> None:
        """The socket is closed."""
        self._end.reset(self._stream)
        self.over.set()
        self._changed.set()
