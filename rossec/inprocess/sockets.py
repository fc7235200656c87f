"""The socket that rospy gets in place of `socket.socket`.

`fileno` is the kernel's: rospy only polls it for a hang-up. Nothing can be read or written around
the channel, which sends no plain bytes. The handshake is in the first read, never in `accept` (N8).
"""

import errno
import socket
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any, Final, Protocol, TypeAlias, TypeVar

from ca.certificates import Identity
from grants.guard import Guard
from rossec import clock
from rossec.channel.opening import WireProtocol
from rossec.channel.records import Bytes
from rossec.errors import ChannelClosed, ChannelError, PlainPeer
from rossec.inprocess.addresses import for_family
from rossec.inprocess.allow_plain import PlainConnection, PlainPeers
from rossec.inprocess.connector import CONNECT_TIMEOUT, Connector, Stream
from rossec.inprocess.plain_stream import PlainStream, peek
from rossec.inprocess.renewing import Renewing
from rossec.inprocess.service_filter import ServiceFilter
from rossec.inprocess.socket_errors import resets, tried_again
from rossec.net.threads.secure_socket import SecureSocket
from rossec.participant.authorized import AuthorizedConnection
from rossec.participant.wishes import NO_WISHES
from rossec.ros.framing import PATIENCE, Framing

_OUT_OF_RESOURCES: Final = (errno.EMFILE, errno.ENFILE, errno.ENOMEM, errno.ENOBUFS)
_READ_SIZE: Final = 256 * 1024
_PUMP_EVERY: Final = 1.0  # seconds
ACCEPT_PAUSE: Final = 1.0  # seconds, while the host is out of descriptors

Received = TypeVar("Received")
Admitted: TypeAlias = "AuthorizedConnection[RosSocket, Guard | None] | PlainConnection"


class SocketOwner(Protocol):
    """The process that a socket belongs to."""

    @property
    def connector(self) -> Connector:
        """Makes its connections."""

    def connection_closed(self, sock: "RosSocket") -> None:
        """A connection is closed."""

    def listens(self, port: int) -> None:
        """Callers are accepted there."""

    @property
    def plain(self) -> PlainPeers:
        """What may stay plain."""

    def connect_error(self, address: tuple[str, int], error: ChannelError) -> Exception:
        """The exception to raise if a connection cannot be secured."""


class RosSocket(Renewing):
    """A socket of rospy's: listening, or one secure connection.

    Attributes:
        connection: the admitted connection; None before the peer is admitted.
        aborted: its right has ended; what had arrived before is discarded.
        closed_locally: closed by this side; later failures are not reported.
        service_filter: filters the calls of a service.
        wishes: what a subscriber is promised of how it is sent messages.
    """

    def __init__(
        self, owner: SocketOwner, sock: socket.socket, stream: Stream | None = None
    ) -> None:
        self._owner = owner
        self._socket = sock
        self._stream: Stream | PlainStream | None = stream
        self.connection: Admitted | None = None
        self.aborted = False
        self.closed_locally = False
        self.service_filter: ServiceFilter | None = None
        self.wishes = NO_WISHES
        self._ready = memoryview(b"")
        self._pump_at = 0.0

    @property
    def stream(self) -> Stream | PlainStream:
        """The connection: secure, unless `allow_plain` names it.

        Raises:
            ChannelClosed: the socket is not connected.
        """
        if self._stream is None:
            raise ChannelClosed("the socket is not connected")
        return self._stream

    @property
    def peer(self) -> Identity:
        """The identity of the peer.

        Raises:
            ChannelClosed: it is not authenticated.
        """
        if self.stream.peer is None:
            raise ChannelClosed("the peer is not authenticated")
        return self.stream.peer

    def handshake(self) -> Identity:
        """Complete the handshake, or raise ChannelError; returns the identity of the peer."""
        if isinstance(self.stream, PlainStream):
            raise ChannelClosed("a plain connection is not authenticated")
        return self.stream.do_handshake()

    def raise_unit_limit(self, limit: int) -> None:
        """The peer is authorized: it may send units of up to `limit` bytes."""
        if isinstance(self._stream, SecureSocket):
            self._stream.raise_unit_limit(limit)

    def pad_units(self, multiple: int) -> None:
        """Pad what is sent from now on to a multiple of so many bytes; 0: do not."""
        if isinstance(self._stream, SecureSocket):
            self._stream.pad_units(multiple)

    @property
    def is_plain(self) -> bool:
        """Whether the connection is not secured."""
        return isinstance(self._stream, PlainStream)

    def peek(self) -> bytes:
        """What a plain caller sends first (`plain_stream.peek`)."""
        return peek(self._socket)

    def switch_to_plain(self) -> None:
        """Continue without the channel: `allow_plain` names what the caller asks for."""
        if isinstance(self._stream, SecureSocket):
            self._stream = PlainStream(self._stream.detach())

    # -- becoming a connection

    def connect(self, address: tuple[str, int]) -> None:
        """Connect and authenticate.

        Raises:
            OSError: no TCP connection. As `SocketOwner.connect_error`: the handshake failed.
        """
        with tried_again():
            self._connect(address)

    def _connect(self, address: tuple[str, int]) -> None:
        self._socket.settimeout(CONNECT_TIMEOUT)
        self._socket.connect(for_family(self._socket.family, address))
        try:
            self._stream = self._owner.connector.initiate(
                self._socket, WireProtocol.TCPROS, address
            )
        except PlainPeer as error:
            if not self._owner.plain:
                raise self._owner.connect_error(address, error) from error
            # Checked with the header, which names the topic or service; nothing is sent before.
            self._socket = socket.create_connection(address, CONNECT_TIMEOUT)
            self._stream = PlainStream(self._socket)
        except ChannelError as error:
            if self.closed_locally:
                raise ConnectionAbortedError(errno.ECONNABORTED, "closed") from error
            raise self._owner.connect_error(address, error) from error

    def bind(self, address: tuple[str, int]) -> None:
        """As `socket.socket`."""
        self._socket.bind(address)

    def listen(self, backlog: int = 128) -> None:
        """As `socket.socket`; rospy's backlog of 5 is too small when a fleet starts."""
        self._socket.listen(max(backlog, 128))
        self._owner.listens(self._socket.getsockname()[1])

    def accept(self) -> tuple["RosSocket", Any]:
        """The next caller within the limits. Its handshake is still to come."""
        while True:
            try:
                sock, where = self._socket.accept()
            except OSError as error:
                if error.errno not in _OUT_OF_RESOURCES:
                    raise
                time.sleep(ACCEPT_PAUSE)
                continue
            if not self._owner.connector.admit(sock, where[0]):
                sock.close()
                continue
            with suppress(OSError):  # an error here would end rospy's thread that accepts
                stream = self._owner.connector.respond(sock, WireProtocol.TCPROS)
                return RosSocket(self._owner, sock, stream), where

    # -- bytes

    def recv(self, size: int) -> bytes:
        """As `socket.socket`."""
        with resets():
            calls = self.service_filter
            return self.stream.recv(size) if calls is None else self._receive_calls(calls, size)

    def _receive_calls(self, calls: ServiceFilter, size: int) -> bytes:
        """What the program may read of a service's calls."""
        while not self._ready:
            receive = partial(self.stream.recv, _READ_SIZE)
            data = self.receive_before_deadline(calls.framing, receive)
            if not data:
                return b""
            ready, reply = calls.incoming(data)
            self._ready = memoryview(ready)
            if reply:
                self.send_unit(*reply)
        part, self._ready = self._ready[:size], self._ready[size:]
        return bytes(part)

    def receive_before_deadline(
        self, framing: Framing, receive: Callable[[], Received]
    ) -> Received:
        """What `receive` returns; a message that has begun must make progress meanwhile.

        Raises:
            LimitExceeded: it does not.
        """
        while framing.incomplete and self.gettimeout() is None:
            self.settimeout(PATIENCE)
            try:
                return receive()
            except TimeoutError:
                framing.check_progress(clock.now())
            finally:
                self.settimeout(None)
        return receive()

    def recv_into(self, buffer: bytearray | memoryview, size: int = 0) -> int:
        """As `socket.socket`."""
        with resets():
            return self.stream.recv_into(buffer, size)

    def send(self, data: Bytes) -> int:
        """As `socket.socket`: everything is sent."""
        self.sendall(data)
        return len(data)

    def sendall(self, data: Bytes) -> None:
        """As `socket.socket`."""
        with resets():
            self.send_unit(data)

    def send_unit(self, *pieces: Bytes) -> None:
        """Send the pieces as one unit; regularly, also process what the channel received.

        Raises:
            ChannelError, OSError: as `SecureSocket.sendall`.
        """
        stream = self.stream
        if time.monotonic() >= self._pump_at:
            stream.pump()
            self._pump_at = time.monotonic() + _PUMP_EVERY
        stream.sendall(*pieces)
        self._pump_soon(stream)

    def try_send(self, data: bytes) -> bool:
        """Send a small unit if that does not block; False: nothing was sent.

        Raises:
            ChannelError: the connection has ended.
        """
        stream = self._stream
        if time.monotonic() >= self._pump_at or not isinstance(stream, SecureSocket):
            return False
        sent = stream.try_send(data)
        self._pump_soon(stream)
        return sent

    @property
    def unsent(self) -> bool:
        """Whether `try_send` left bytes for `send_unit` to send."""
        return isinstance(self._stream, SecureSocket) and self._stream.unsent

    def run_timers(self) -> None:
        """`SecureSocket.run_timers`; an error there is raised where the connection is used."""
        if isinstance(self._stream, SecureSocket):
            with suppress(ChannelError, OSError):
                self._stream.run_timers()
                self._pump_soon(self._stream)

    def _pump_soon(self, stream: Stream | PlainStream) -> None:
        """Process the peer's answer to a key update before the next message."""
        if stream.awaits_peer:
            self._pump_at = 0.0

    # -- options and closing

    def fileno(self) -> int:
        """The kernel's descriptor, to poll for a hang-up; -1 when closed."""
        return self._socket.fileno()

    def settimeout(self, value: float | None) -> None:
        """As `socket.socket`."""
        (self._stream or self._socket).settimeout(value)

    def gettimeout(self) -> float | None:
        """As `socket.socket`."""
        return (self._stream or self._socket).gettimeout()

    def setblocking(self, flag: bool) -> None:
        """As `socket.socket`."""
        self.settimeout(None if flag else 0.0)

    def setsockopt(self, *arguments: Any) -> None:
        """As `socket.socket`."""
        self._socket.setsockopt(*arguments)

    def getsockopt(self, *arguments: Any) -> int | bytes:
        """As `socket.socket`."""
        return self._socket.getsockopt(*arguments)

    def getsockname(self) -> Any:
        """As `socket.socket`."""
        return self._socket.getsockname()

    def getpeername(self) -> Any:
        """As `socket.socket`: for logs, never for trust."""
        return self._socket.getpeername()

    def shutdown(self, how: int = socket.SHUT_RDWR) -> None:
        """Close in order."""
        self.closed_locally = True
        if self._stream is not None:
            self._stream.shutdown(how)
        else:
            with suppress(OSError):
                self._socket.shutdown(how)

    def abort(self, _reason: str = "") -> None:
        """End it now, from any thread: blocked calls return, and nothing more is received."""
        self.aborted = True
        if isinstance(self._stream, SecureSocket):
            self._stream.abort()
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """As `socket.socket`."""
        self.closed_locally = True
        self._owner.connection_closed(self)
        if self._stream is not None:
            self._stream.close()
        self._socket.close()
