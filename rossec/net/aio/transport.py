"""One non-blocking socket on a loop: bytes in, bytes out, nothing else.

Not an asyncio transport: those copy what the kernel does not take at once, twice for a large
record, and cost more calls per message. Here a remainder is copied once, and the socket is read
straight into the owner's buffer.
"""

import asyncio
import socket
import struct
from collections import deque
from contextlib import suppress
from typing import Final, Protocol

from rossec.channel.records import Bytes
from rossec.net.bounds import UNSENT

_RESET_ON_CLOSE: Final = struct.pack("ii", 1, 0)
_HIGH_WATER: Final = 64 * 1024  # bytes buffered here, above which a writer should wait


class TransportOwner(Protocol):
    """Receives the events of the socket; names as in `asyncio.BufferedProtocol`."""

    def get_buffer(self) -> memoryview:
        """The buffer for the next bytes.

        Raises:
            BlockingIOError: there is no room; the owner has paused reading.
        """
        ...

    def buffer_updated(self, count: int) -> None:
        """So many bytes were written there."""
        ...

    def eof_received(self) -> bool | None:
        """The peer sends nothing more; true: this side does, the socket stays open."""
        ...

    def resume_writing(self) -> None:
        """Everything written is with the kernel."""
        ...

    def connection_lost(self) -> None:
        """The socket is closed; called once, never from within a call of this class."""
        ...


class ByteTransport(Protocol):
    """What carries the bytes of one connection: `Transport`, or a link between sites.

    `rossec.net.aio.driver.Driver` is given a function that makes it for its owner.
    """

    @property
    def backlog(self) -> int:
        """How many bytes are buffered here."""
        ...

    @property
    def closed(self) -> bool:
        """Whether nothing more is sent or received."""
        ...

    @property
    def local_address(self) -> str:
        """This side's IP address, as the peer sees it unless there is NAT between; or empty."""
        ...

    @property
    def writable(self) -> bool:
        """Whether a writer need not wait."""
        ...

    @property
    def reading(self) -> bool:
        """Whether arriving bytes are read."""
        ...

    def resume_reading(self) -> None:
        """Read whenever bytes arrive."""
        ...

    def pause_reading(self) -> None:
        """Read no more for now; flow control slows the peer."""
        ...

    def write(self, data: Bytes) -> None:
        """Send `data`, which may change afterwards."""
        ...

    def limit_unsent(self) -> None:
        """Take no more than a line can send soon: what is written then leaves soon."""
        ...

    def write_eof(self) -> None:
        """End this side's stream after what was written."""
        ...

    def finish(self) -> None:
        """Close once everything is written: both sides have closed."""
        ...

    def abort(self) -> None:
        """Close now; what was not sent is dropped."""
        ...


class Transport:
    """The socket of one connection; it owns the socket from the beginning."""

    __slots__ = (
        "_closing",
        "_eof_due",
        "_fd",
        "_loop",
        "_owner",
        "_pending",
        "_reading",
        "_socket",
        "backlog",
        "closed",
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
        self._closing = self._eof_due = self._reading = False

    @property
    def local_address(self) -> str:
        """This side's IP address, as the peer sees it unless there is NAT between.

        Empty when the connection is gone.
        """
        try:
            host: str = self._socket.getsockname()[0]
        except OSError:
            return ""
        return host

    @property
    def writable(self) -> bool:
        """Whether a writer need not wait."""
        return self.backlog <= _HIGH_WATER

    # -- reading

    @property
    def reading(self) -> bool:
        """Whether arriving bytes are read."""
        return self._reading

    def resume_reading(self) -> None:
        """Read whenever bytes arrive."""
        if not (self._reading or self._closing or self.closed):
            self._reading = True
            self._loop.add_reader(self._fd, self._readable)

    def pause_reading(self) -> None:
        """Leave arriving bytes in the kernel, whose flow control slows the peer."""
        if self._reading:
            self._reading = False
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
        """Have the kernel take little more than it can send: its buffer may hold seconds."""
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
