"""The socket that rospy gets in place of `socket.socket`, and the filter of service calls on it.

Nothing can be read or written around the channel, which sends no plain bytes. Where a grant restricts the
right to a service, requests and responses are filtered as in the built-in node
(`rossec.participant.service_types`): what is not allowed never reaches the program, and the other side
gets the reason.
"""

import errno
import ipaddress
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any, Final, Protocol, TypeAlias, TypeVar

from ca.certificates import Identity
from ca.errors import HintedError
from grants.guard import Guard
from rossec import clock
from rossec.channel.opening import WireProtocol
from rossec.channel.records import Bytes
from rossec.errors import ChannelClosed, ChannelError, ConfigurationError, PlainPeer
from rossec.inprocess.identity import CONNECT_TIMEOUT, Connector, PlainSocketStream, Renewing, Stream, peek
from rossec.inprocess.options import PlainConnection, PlainPeers
from rossec.net.threads.secure_socket import SecureSocket
from rossec.participant.authorized import AuthorizedConnection
from rossec.participant.delivery_options import NO_OPTIONS
from rossec.participant.service_types import ServiceGuard
from rossec.ros import tcpros as wire
from rossec.ros.tcpros import MESSAGE_LIMIT, PATIENCE, FrameReader, Framing

ROSRPC: Final = "rosrpc://"
_ENDED: Final = (errno.ECONNRESET, errno.EPIPE, errno.ENOTCONN)
_OK: Final = b"\1"
_LENGTH: Final = 4
Pieces = tuple[Bytes, ...]
_OUT_OF_RESOURCES: Final = (errno.EMFILE, errno.ENFILE, errno.ENOMEM, errno.ENOBUFS)
_READ_SIZE: Final = 256 * 1024
_PUMP_EVERY: Final = 1.0  # seconds
ACCEPT_PAUSE: Final = 1.0  # seconds, while the host is out of descriptors
Received = TypeVar("Received")
Admitted: TypeAlias = "AuthorizedConnection[RosSocket, Guard | None] | PlainConnection"


def bracketed(uri: str) -> str:
    scheme, mark, rest = uri.partition("://")
    authority, slash, path = rest.partition("/")
    host, colon, port = authority.rpartition(":")
    if ":" not in host or host.startswith("["):
        return uri
    return f"{scheme}{mark}[{host}]{colon}{port}{slash}{path}"


def parse_rosrpc(uri: str) -> tuple[str, int]:
    authority = uri.removeprefix(ROSRPC).partition("/")[0]
    host, _, port = authority.rpartition(":")
    if not uri.startswith(ROSRPC) or not host or not port.isdecimal():
        raise ConfigurationError(f"{uri!r} is not the URI of a service", "it has the form rosrpc://host:port")
    return host.removeprefix("[").removesuffix("]"), int(port)


def for_family(family: int, address: tuple[str, int]) -> tuple[str, int]:
    """`address` as a socket of this family takes it: an IPv4 literal for IPv6 is mapped.

    With ROS_IPV6=on all sockets of rospy are of IPv6; a relay's forwarded ports are at 127.0.0.1.
    """
    host, port = address
    try:
        mapped = family == socket.AF_INET6 and ipaddress.ip_address(host).version == 4
    except ValueError:  # a name
        return address
    return (f"::ffff:{host}", port) if mapped else address


@contextmanager
def resets() -> Iterator[None]:
    try:
        yield
    except HintedError as error:
        raise ConnectionResetError(errno.ECONNRESET, f"rossec: {error}") from error


# rospy tries a publisher again after ECONNABORTED, a timeout or a network that is gone, and gives it
# up after any other error of a socket: after a reset, too. But one that accepts and resets is not
# gone, as at the forwarded port of a relay while the other site is out of reach.
@contextmanager
def tried_again() -> Iterator[None]:
    try:
        yield
    except OSError as error:
        if error.errno not in _ENDED:
            raise
        raise ConnectionAbortedError(errno.ECONNABORTED, str(error)) from error


class ServerFilter:
    """The provider's side; `check` raises when the connection must be closed now."""

    def __init__(
        self,
        check: Callable[[], None],
        guard: ServiceGuard | None,
        on_refusal: Callable[[HintedError], None],
        now: Callable[[], float],
        limit: int = MESSAGE_LIMIT,
    ) -> None:
        self.framing = Framing(FrameReader(limit))
        self.guard = guard  # another thread may put another in its place
        self._check, self._on_refusal, self._now = check, on_refusal, now

    def incoming(self, data: bytes) -> tuple[bytes, Pieces]:
        # One frame, bounded before it is buffered.
        request = self.framing.feed_one(data, int(self._now()))
        if request is None:
            return b"", ()
        self._check()  # a call is forwarded only while the caller's right lasts
        guard = self.guard
        if guard is None:
            return b"".join(wire.framed([request])), ()
        try:
            return b"".join(wire.framed(guard.request(request, self._now()))), ()
        except HintedError as error:
            return b"", self._refusal(error)

    def outgoing(self, data: bytes) -> Pieces:
        guard = self.guard
        if guard is None or data[:1] != _OK:
            return (data,)
        response = memoryview(data)[len(_OK) + _LENGTH :]
        try:
            return tuple(wire.success(guard.response(response, self._now())))
        except HintedError as error:
            return self._refusal(error)

    def _refusal(self, error: HintedError) -> Pieces:
        self._on_refusal(error)
        return tuple(wire.failure(f"rossec: {error}"))


class ClientFilter:
    def __init__(
        self, guard: ServiceGuard | None, now: Callable[[], float], limit: int = MESSAGE_LIMIT
    ) -> None:
        self.framing = Framing(FrameReader(limit, lead=len(_OK)))
        self.guard, self._now = guard, now

    def incoming(self, data: bytes) -> tuple[bytes, Pieces]:
        content = self.framing.feed_one(data, int(self._now()))
        if content is None:
            return b"", ()
        mark, response = content[: len(_OK)], content[len(_OK) :]
        guard = self.guard
        if mark != _OK or guard is None:
            return b"".join((mark, *wire.framed([response]))), ()
        try:
            return b"".join(wire.success(guard.response(response, self._now()))), ()
        except HintedError as error:
            return b"".join(wire.failure(f"rossec: {error}")), ()

    def outgoing(self, data: bytes) -> Pieces:
        guard = self.guard
        if guard is None:
            return (data,)
        request = memoryview(data)[_LENGTH:]
        return tuple(wire.framed(guard.request(request, self._now())))


class SocketOwner(Protocol):
    @property
    def connector(self) -> Connector: ...
    def connection_closed(self, sock: "RosSocket") -> None: ...
    def listens(self, port: int) -> None: ...
    @property
    def plain(self) -> PlainPeers: ...
    def connect_error(self, address: tuple[str, int], error: ChannelError) -> Exception: ...


class RosSocket(Renewing):
    """A socket of rospy's: listening, or one secure connection."""

    def __init__(self, owner: SocketOwner, sock: socket.socket, stream: Stream | None = None) -> None:
        self._owner = owner
        self._socket = sock
        self._stream: Stream | PlainSocketStream | None = stream
        self.connection: Admitted | None = None  # after the peer is admitted
        self.aborted = False  # its right has ended; what had arrived before is discarded
        self.closed_locally = False  # later failures are not reported
        self.service_filter: ServerFilter | ClientFilter | None = None
        self.options = NO_OPTIONS  # what a subscriber is promised of how it is sent messages
        self._ready = memoryview(b"")
        self._pump_at = 0.0

    @property
    def stream(self) -> Stream | PlainSocketStream:
        # The connection: secure, unless `allow_plain` names it.
        if self._stream is None:
            raise ChannelClosed("the socket is not connected")
        return self._stream

    @property
    def peer(self) -> Identity:
        if self.stream.peer is None:
            raise ChannelClosed("the peer is not authenticated")
        return self.stream.peer

    def handshake(self) -> Identity:
        if isinstance(self.stream, PlainSocketStream):
            raise ChannelClosed("a plain connection is not authenticated")
        return self.stream.do_handshake()

    def raise_unit_limit(self, limit: int) -> None:
        if isinstance(self._stream, SecureSocket):
            self._stream.raise_unit_limit(limit)

    def pad_units(self, multiple: int) -> None:
        if isinstance(self._stream, SecureSocket):
            self._stream.pad_units(multiple)

    @property
    def is_plain(self) -> bool:
        return isinstance(self._stream, PlainSocketStream)

    def peek(self) -> bytes:
        return peek(self._socket)

    def switch_to_plain(self) -> None:
        if isinstance(self._stream, SecureSocket):
            self._stream = PlainSocketStream(self._stream.detach())

    # -- becoming a connection

    def connect(self, address: tuple[str, int]) -> None:
        with tried_again():
            self._socket.settimeout(CONNECT_TIMEOUT)
            self._socket.connect(for_family(self._socket.family, address))
            try:
                self._stream = self._owner.connector.initiate(self._socket, WireProtocol.TCPROS, address)
            except PlainPeer as error:
                if not self._owner.plain:
                    raise self._owner.connect_error(address, error) from error
                # Checked with the header, which names the topic or service; nothing is sent before.
                self._socket = socket.create_connection(address, CONNECT_TIMEOUT)
                self._stream = PlainSocketStream(self._socket)
            except ChannelError as error:
                if self.closed_locally:
                    raise ConnectionAbortedError(errno.ECONNABORTED, "closed") from error
                raise self._owner.connect_error(address, error) from error

    def bind(self, address: tuple[str, int]) -> None:
        self._socket.bind(address)

    def listen(self, backlog: int = 128) -> None:
        self._socket.listen(max(backlog, 128))
        self._owner.listens(self._socket.getsockname()[1])

    def accept(self) -> tuple["RosSocket", Any]:
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
                # The handshake is in the first read, never here: a silent caller would keep out others (N8).
                stream = self._owner.connector.respond(sock, WireProtocol.TCPROS)
                return RosSocket(self._owner, sock, stream), where

    # -- bytes

    def recv(self, size: int) -> bytes:
        with resets():
            calls = self.service_filter
            if calls is None:
                return self.stream.recv(size)
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

    def receive_before_deadline(self, framing: Framing, receive: Callable[[], Received]) -> Received:
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
        with resets():
            return self.stream.recv_into(buffer, size)

    def send(self, data: Bytes) -> int:
        self.sendall(data)
        return len(data)

    def sendall(self, data: Bytes) -> None:
        with resets():
            self.send_unit(data)

    def send_unit(self, *pieces: Bytes) -> None:
        # What the peer says (renewals, the end) is looked at now and then also while this side only writes.
        stream = self.stream
        if time.monotonic() >= self._pump_at:
            stream.pump()
            self._pump_at = time.monotonic() + _PUMP_EVERY
        stream.sendall(*pieces)
        self._pump_soon(stream)

    def try_send(self, data: bytes) -> bool:
        stream = self._stream
        if time.monotonic() >= self._pump_at or not isinstance(stream, SecureSocket):
            return False
        sent = stream.try_send(data)
        self._pump_soon(stream)
        return sent

    @property
    def unsent(self) -> bool:
        return isinstance(self._stream, SecureSocket) and self._stream.unsent

    def run_timers(self) -> None:
        if isinstance(self._stream, SecureSocket):
            with suppress(ChannelError, OSError):
                self._stream.run_timers()
                self._pump_soon(self._stream)

    def _pump_soon(self, stream: Stream | PlainSocketStream) -> None:
        if stream.awaits_peer:
            self._pump_at = 0.0

    # -- options and closing

    def fileno(self) -> int:
        # The kernel's: rospy only polls it for a hang-up.
        return self._socket.fileno()

    def settimeout(self, value: float | None) -> None:
        (self._stream or self._socket).settimeout(value)

    def gettimeout(self) -> float | None:
        return (self._stream or self._socket).gettimeout()

    def setblocking(self, flag: bool) -> None:
        self.settimeout(None if flag else 0.0)

    def setsockopt(self, *arguments: Any) -> None:
        self._socket.setsockopt(*arguments)

    def getsockopt(self, *arguments: Any) -> int | bytes:
        return self._socket.getsockopt(*arguments)

    def getsockname(self) -> Any:
        return self._socket.getsockname()

    def getpeername(self) -> Any:
        # As `socket.socket`: for logs, never for trust.
        return self._socket.getpeername()

    def shutdown(self, how: int = socket.SHUT_RDWR) -> None:
        self.closed_locally = True
        if self._stream is not None:
            self._stream.shutdown(how)
        else:
            with suppress(OSError):
                self._socket.shutdown(how)

    def abort(self, _reason: str = "") -> None:
        if not self.aborted:
            self.disconnect()

    def disconnect(self) -> None:
        self.aborted = True
        if isinstance(self._stream, SecureSocket):
            self._stream.abort()
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        self.closed_locally = True
        self._owner.connection_closed(self)
        if self._stream is not None:
            self._stream.close()
        self._socket.close()
