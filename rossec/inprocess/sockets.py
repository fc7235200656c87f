"""What rospy takes for a socket and for the module `socket`.

`fileno` is the kernel's: rospy only watches it for a peer that hangs up. Nothing can be read or
written around the channel: there is no path here that sends plain bytes. The handshake of an
accepted connection happens in the first read, never in `accept` (attack N8).
"""

import errno
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any, Final, Protocol, TypeVar

from ca.certificates import Identity
from ca.errors import HintedError
from rossec import clock
from rossec.channel.opening import WireProtocol
from rossec.channel.records import Bytes
from rossec.errors import ChannelClosed, ChannelError, PlainPeer
from rossec.inprocess.allow_plain import PlainPeers
from rossec.inprocess.connector import CONNECT_TIMEOUT, Connector, Stream
from rossec.inprocess.live_connections import LiveConnection, PlainConnection
from rossec.inprocess.plain_stream import PlainStream, peek
from rossec.inprocess.service_filter import ServiceFilter
from rossec.net.threads.secure_socket import SecureSocket
from rossec.ros.framing import PATIENCE, Framing

_OUT_OF_THEM: Final = (errno.EMFILE, errno.ENFILE, errno.ENOMEM, errno.ENOBUFS)
_AT_A_TIME: Final = 256 * 1024
_PUMP_EVERY: Final = 1.0  # seconds
_REST: Final = 1.0  # seconds, when the host is out of descriptors: callers wait in the kernel

Taken = TypeVar("Taken")


class SocketOwner(Protocol):
    """Whom a socket belongs to."""

    @property
    def doors(self) -> Connector:
        """Makes its connections."""

    def gone(self, sock: "RosSocket") -> None:
        """A connection is over."""

    def listens(self, port: int) -> None:
        """Callers are accepted there."""

    @property
    def plain(self) -> PlainPeers:
        """What may stay plain."""

    def failed(self, address: tuple[str, int], error: ChannelError) -> Exception:
        """What to raise where a connection cannot be secured."""


class RosSocket:
    """A socket of rospy's: listening, or one secure connection.

    Attributes:
        link: what the peer was admitted by; None while it is not admitted.
        ended: it was cut; what had arrived before does not count any more.
        left: this side has closed it; what fails after that is no news.
        exchange: what the calls of a service pass through.
    """

    def __init__(
        self, owner: SocketOwner, sock: socket.socket, stream: Stream | None = None
    ) -> None:
        self._owner = owner
        self._socket = sock
        self._stream: Stream | PlainStream | None = stream
        self.link: LiveConnection | PlainConnection | None = None
        self.ended = False
        self.left = False
        self.exchange: ServiceFilter | None = None
        self._ready = memoryview(b"")
        self._pump_at = 0.0

    @property
    def stream(self) -> Stream | PlainStream:
        """The connection: secure, but where `allow_plain` names it.

        Raises:
            ChannelClosed: there is none.
        """
        if self._stream is None:
            raise ChannelClosed("the socket is not connected")
        return self._stream

    @property
    def peer(self) -> Identity:
        """Who is at the other end.

        Raises:
            ChannelClosed: nobody that is authenticated.
        """
        if self.stream.peer is None:
            raise ChannelClosed("the peer is not authenticated")
        return self.stream.peer

    def handshake(self) -> Identity:
        """Who is at the other end, once that is proved.

        Raises:
            ChannelError: it is not.
        """
        stream = self.stream
        if isinstance(stream, PlainStream):
            raise ChannelClosed("a plain connection proves nothing")
        return stream.do_handshake()

    def raise_unit_limit(self, limit: int) -> None:
        """The peer was judged: what it sends may come in units of up to `limit`."""
        if isinstance(self._stream, SecureSocket):
            self._stream.raise_unit_limit(limit)

    @property
    def is_plain(self) -> bool:
        """Whether nobody vouches for this connection."""
        return isinstance(self._stream, PlainStream)

    def peek(self) -> bytes:
        """What a plain caller sends first (`plainsocket.peek`)."""
        return peek(self._socket)

    def go_plain(self) -> None:
        """Go on without the channel: `allow_plain` names what the caller wants."""
        if isinstance(self._stream, SecureSocket):
            self._stream = PlainStream(self._stream.detach())

    # -- becoming a connection

    def connect(self, address: tuple[str, int]) -> None:
        """Connect and authenticate.

        Raises:
            OSError: no TCP connection. What `SocketOwner.failed` says: the handshake failed.
        """
        self._socket.settimeout(CONNECT_TIMEOUT)
        self._socket.connect(address)
        try:
            self._stream = self._owner.doors.call(self._socket, WireProtocol.TCPROS, address)
        except PlainPeer as error:
            if not self._owner.plain:
                raise self._owner.failed(address, error) from error
            # Nothing is said yet: which topic or service this is for is known with the header.
            self._socket = socket.create_connection(address, CONNECT_TIMEOUT)
            self._stream = PlainStream(self._socket)
        except ChannelError as error:
            if self.left:
                raise ConnectionAbortedError(errno.ECONNABORTED, "closed") from error
            raise self._owner.failed(address, error) from error

    def bind(self, address: tuple[str, int]) -> None:
        """As of sockets."""
        self._socket.bind(address)

    def listen(self, backlog: int = 128) -> None:
        """As of sockets; rospy's own backlog of 5 is few when a fleet starts."""
        self._socket.listen(max(backlog, 128))
        self._owner.listens(self._socket.getsockname()[1])

    def accept(self) -> tuple["RosSocket", Any]:
        """The next caller within the caps. Its handshake is still to come."""
        while True:
            try:
                sock, where = self._socket.accept()
            except OSError as error:
                if error.errno not in _OUT_OF_THEM:
                    raise
                time.sleep(_REST)
                continue
            if not self._owner.doors.admit(sock, where[0]):
                sock.close()
                continue
            with suppress(OSError):  # an error here would end rospy's thread that accepts
                stream = self._owner.doors.answer(sock, WireProtocol.TCPROS)
                return RosSocket(self._owner, sock, stream), where

    # -- bytes

    def recv(self, size: int) -> bytes:
        """As of sockets."""
        with _as_of_sockets():
            return self.stream.recv(size) if self.exchange is None else self._exchanged(size)

    def _exchanged(self, size: int) -> bytes:
        """What of a service's calls the program may read."""
        assert self.exchange is not None  # noqa: S101 - asked by the caller
        while not self._ready:
            data = self.patiently(self.exchange.framing, partial(self.stream.recv, _AT_A_TIME))
            if not data:
                return b""
            ready, reply = self.exchange.incoming(data)
            self._ready = memoryview(ready)
            if reply:
                self.send_unit(*reply)
        part, self._ready = self._ready[:size], self._ready[size:]
        return bytes(part)

    def patiently(self, framing: Framing, take: Callable[[], Taken]) -> Taken:
        """What `take` receives; a message that was begun must get on meanwhile.

        Raises:
            LimitExceeded: it does not.
        """
        while framing.incomplete and self.gettimeout() is None:
            self.settimeout(PATIENCE)
            try:
                return take()
            except TimeoutError:
                framing.check_progress(clock.now())
            finally:
                self.settimeout(None)
        return take()

    def recv_into(self, buffer: bytearray | memoryview, size: int = 0) -> int:
        """As of sockets."""
        with _as_of_sockets():
            return self.stream.recv_into(buffer, size)

    def send(self, data: Bytes) -> int:
        """As of sockets: everything is sent."""
        self.sendall(data)
        return len(data)

    def sendall(self, data: Bytes) -> None:
        """As of sockets."""
        with _as_of_sockets():
            self.send_unit(data)

    def send_unit(self, *pieces: Bytes) -> None:
        """Send the pieces as one unit, and take in what the peer's side of the channel needs.

        Raises:
            ChannelError, OSError: as of `SecureSocket`.
        """
        stream = self.stream
        if time.monotonic() >= self._pump_at:
            stream.pump()
            self._pump_at = time.monotonic() + _PUMP_EVERY
        stream.sendall(*pieces)
        self._hurry(stream)

    def try_send(self, data: bytes) -> bool:
        """Send a small unit where this needs no waiting; False: nothing has happened.

        Raises:
            ChannelError: the connection is at its end.
        """
        stream = self._stream
        if time.monotonic() >= self._pump_at or not isinstance(stream, SecureSocket):
            return False
        sent = stream.try_send(data)
        self._hurry(stream)
        return sent

    @property
    def unsent(self) -> bool:
        """Whether `try_send` left something, for `send_unit` to send."""
        return isinstance(self._stream, SecureSocket) and self._stream.unsent

    def run_timers(self) -> None:
        """`SecureSocket.run_timers`; what fails there is met where the connection is used."""
        if isinstance(self._stream, SecureSocket):
            with suppress(ChannelError, OSError):
                self._stream.run_timers()
                self._hurry(self._stream)

    def _hurry(self, stream: Stream | PlainStream) -> None:
        """Look for the peer's answer to a renewal before the next message."""
        if stream.awaits_peer:
            self._pump_at = 0.0

    # -- options and ends

    def fileno(self) -> int:
        """The kernel's descriptor, to watch for a hang-up; -1 when closed."""
        return self._socket.fileno()

    def settimeout(self, value: float | None) -> None:
        """As of sockets."""
        (self._stream or self._socket).settimeout(value)

    def gettimeout(self) -> float | None:
        """As of sockets."""
        return (self._stream or self._socket).gettimeout()

    def setblocking(self, flag: bool) -> None:
        """As of sockets."""
        self.settimeout(None if flag else 0.0)

    def setsockopt(self, *arguments: Any) -> None:
        """As of sockets."""
        self._socket.setsockopt(*arguments)

    def getsockopt(self, *arguments: Any) -> int | bytes:
        """As of sockets."""
        return self._socket.getsockopt(*arguments)

    def getsockname(self) -> Any:
        """As of sockets."""
        return self._socket.getsockname()

    def getpeername(self) -> Any:
        """As of sockets: for logs, never for trust."""
        return self._socket.getpeername()

    def shutdown(self, how: int = socket.SHUT_RDWR) -> None:
        """Close in order."""
        self.left = True
        if self._stream is not None:
            self._stream.shutdown(how)
        else:
            with suppress(OSError):
                self._socket.shutdown(how)

    def abort(self) -> None:
        """End it now, from any thread: whoever waits in it wakes, and receives nothing more."""
        self.ended = True
        if isinstance(self._stream, SecureSocket):
            self._stream.abort()
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """As of sockets."""
        self.left = True
        self._owner.gone(self)
        if self._stream is not None:
            self._stream.close()
        self._socket.close()


@contextmanager
def _as_of_sockets() -> Iterator[None]:
    """rospy knows the errors of sockets."""
    try:
        yield
    except HintedError as error:
        raise ConnectionResetError(errno.ECONNRESET, f"rossec: {error}") from error
