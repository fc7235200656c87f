"""Connecting: TCP to whichever address of a host answers first (RFC 8305), then the handshake."""

import asyncio
import contextlib
import errno
import os
import socket
from collections.abc import Awaitable, Callable
from functools import partial
from typing import Final

from aiohappyeyeballs import start_connection

from rossec import errors
from rossec.channel.connection import Connection
from rossec.channel.edhoc.credentials import PeerT
from rossec.channel.opening import WireProtocol
from rossec.net.aio.stream import SecureStream
from rossec.net.aio.transport import ByteTransport, Transport, TransportOwner
from rossec.net.context import SecureContext

STAGGER: Final = 0.25  # seconds; RFC 8305 section 5
_CONNECT_TIMEOUT: Final = 10.0
_NOT_RUNNING: Final = (
    "is the peer running, and ROS_HOSTNAME or ROS_IP right on its side? If it is the master:"
    " start it with rossec master, and check ROS_MASTER_URI here"
)
_START_MASTER: Final = "start it: rossec master; or set ROS_MASTER_URI to where it runs"
_PLAIN_MASTER: Final = (
    "stop it, and start the other in its place: rossec master; or set ROS_MASTER_URI to where that runs"
)
_OTHER_MASTER: Final = (
    "stop the master that runs there, or set ROS_MASTER_URI to where that of this authority runs;"
    " is ROSSEC_HOME the right one?"
)


async def connect(
    host: str,
    port: int,
    context: SecureContext[PeerT],
    protocol: WireProtocol = WireProtocol.TCPROS,
    *,
    to_itself: bool = False,
    timeout: float = _CONNECT_TIMEOUT,  # noqa: ASYNC109 - one deadline over TCP and handshake
) -> SecureStream[PeerT]:
    """Connect and authenticate; one round trip after TCP's own.

    The responder's verdict on this side's certificate arrives later, as `PeerRefused` from `receive` or
    `send`. With `context.known`, the handshake is repeated by value after error 3. `to_itself`: this node
    means to reach itself. Raises PeerUnreachable: no TCP connection; PlainPeer: a plain ROS node answered;
    ChannelError: the handshake failed; the leaf says how.
    """
    core = partial(context.initiator, protocol, to_itself=to_itself)
    known = context.known
    if known is None:
        return await _handshake(await _dial(host, port, timeout), core)
    request_x5t = (host, port) in known.addresses
    try:
        by_hash = partial(core, request_x5t=request_x5t)
        stream = await _handshake(await _dial(host, port, timeout), by_hash)
    except (errors.HandshakeFailed, errors.PeerRefused) as error:
        # Any failure of a handshake by hash may be due to the hash.
        # Error 3 is not authenticated: whoever forges it costs one more handshake, by value.
        if isinstance(error, errors.PeerCredentialUnknown | errors.OwnCredentialUnknown):
            known.introduced.clear()
        elif not request_x5t or isinstance(error, errors.HandshakeTimeout):
            raise
        stream = await _handshake(await _dial(host, port, timeout), core)
    known.addresses[host, port] = None
    return stream


async def _handshake(sock: socket.socket, core: Callable[[], Connection[PeerT]]) -> SecureStream[PeerT]:
    try:
        connection, address = core(), sock.getpeername()[0]
        ready = authenticate(connection, partial(Transport, sock), address)
    except OSError as error:
        sock.close()
        hint = "the peer is overloaded, or something on the path resets connections"
        raise errors.PeerUnreachable(f"the connection was reset at once: {error}", hint) from error
    except BaseException:
        sock.close()
        raise
    return await ready


def authenticate(
    connection: Connection[PeerT], transport: Callable[[TransportOwner], ByteTransport], address: str
) -> Awaitable[SecureStream[PeerT]]:
    """Begin the handshake over this transport; what is returned waits for its end. Raises ChannelError: the
    handshake failed; raised by what is returned; OSError: of the transport, which is the caller's then."""
    ready: asyncio.Future[SecureStream[PeerT]] = asyncio.get_running_loop().create_future()

    def on_authenticated(stream: SecureStream[PeerT]) -> None:
        if not ready.done():
            ready.set_result(stream)

    def on_end(_: SecureStream[PeerT], error: errors.ChannelError) -> None:
        if not ready.done():
            ready.set_exception(error.bare())

    stream = SecureStream(connection, transport, address, on_authenticated, on_end)
    return _wait(stream, ready)


async def _wait(
    stream: SecureStream[PeerT], ready: asyncio.Future[SecureStream[PeerT]]
) -> SecureStream[PeerT]:
    try:
        return await ready
    except BaseException:
        stream.abort("the caller no longer waits for the connection")
        raise
    finally:
        del ready  # its error refers to this frame


async def dial(host: str, port: int, within: float) -> socket.socket:
    """Return a connected, non-blocking socket within that time in seconds."""
    family = _family(host)
    if family is None:
        loop, task = asyncio.get_running_loop(), asyncio.current_task()
        async with asyncio.timeout(within):
            found = await loop.getaddrinfo(host, port, type=socket.SOCK_STREAM)
            if not found:
                raise OSError(f"no address for {host}")
            cancelled = task is not None and task.cancelling()
            # A library chooses among the addresses of a host (0023).
            sock = await start_connection(found, happy_eyeballs_delay=STAGGER)
            if task is not None and task.cancelling() > cancelled:  # while other attempts were ended
                sock.close()
                raise asyncio.CancelledError
            return sock
    # No thread, no resolver, and on loopback no waiting.
    sock = socket.socket(family, socket.SOCK_STREAM)
    try:
        sock.setblocking(False)
        if sock.connect_ex((host, port)) != errno.EINPROGRESS or not _connected(sock):
            async with asyncio.timeout(within):
                await asyncio.get_running_loop().sock_connect(sock, (host, port))
    except BaseException:
        sock.close()
        raise
    return sock


def _family(host: str) -> int | None:
    for family in (socket.AF_INET, socket.AF_INET6):
        with contextlib.suppress(OSError):
            socket.inet_pton(family, host)
            return family
    return None


def _connected(sock: socket.socket) -> bool:
    try:
        sock.getpeername()
    except OSError:
        return False
    return True


async def _dial(host: str, port: int, timeout: float) -> socket.socket:  # noqa: ASYNC109 - passed on by `connect`
    try:
        return await dial(host, port, timeout)
    except (OSError, TimeoutError, ValueError, IndexError, OverflowError) as error:
        # An invalid host or port: UnicodeError, IndexError and so on, by Python version.
        text = f"cannot connect to {host} port {port}: {_reason(error)}"
        raise errors.PeerUnreachable(text, _NOT_RUNNING) from error


def _reason(error: Exception) -> str:
    if isinstance(error, TimeoutError):
        return "it does not answer"
    if not isinstance(error, OSError):
        return str(error)
    if isinstance(error.errno, int) and error.errno > 0:  # the loop's text repeats the address
        return os.strerror(error.errno).lower()
    return error.strerror.lower() if error.strerror else str(error)


def as_master(error: errors.ChannelError) -> errors.ChannelError:
    """The same error, where it is known that the peer should be the master: what to do."""
    match error:
        case errors.PeerUnreachable(hint=hint):
            return errors.PeerUnreachable(str(error), _START_MASTER if hint == _NOT_RUNNING else hint)
        case errors.PlainPeer():
            text = f"what runs at the master's address is a plain master, roscore perhaps: {error}"
            return errors.PlainPeer(text, _PLAIN_MASTER)
        case errors.ForeignIdentity():
            text = f"what runs at the master's address is of another authority: {error}"
            return errors.ForeignIdentity(text, _OTHER_MASTER)
        case _:
            return error
