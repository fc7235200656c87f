"""Connecting: TCP over IPv4 or IPv6, whichever answers first, then the handshake."""

import asyncio
import secrets
import socket
from collections.abc import Callable
from functools import partial
from typing import Final

from rossec.channel.connection import Connection
from rossec.channel.edhoc.credentials import OwnCredential, PeerT, Verify
from rossec.channel.edhoc.known import KnownCertificates
from rossec.channel.edhoc.own_dials import OwnDials
from rossec.channel.edhoc.suites import PRODUCTION
from rossec.channel.opening import WireProtocol
from rossec.channel.records import ChannelLimits
from rossec.errors import (
    ChannelClosed,
    ChannelError,
    HandshakeFailed,
    HandshakeTimeout,
    OwnCredentialUnknown,
    PeerCredentialUnknown,
    PeerRefused,
    PeerUnreachable,
)
from rossec.net.aio.dial import dial
from rossec.net.aio.driver import Driver, wall_clock
from rossec.net.aio.stream import SecureStream

_CONNECT_TIMEOUT: Final = 10.0
_DEFAULTS: Final = ChannelLimits()


async def connect(
    host: str,
    port: int,
    credentials: OwnCredential,
    verify: Verify[PeerT],
    *,
    opening: WireProtocol = WireProtocol.TCPROS,
    limits: ChannelLimits = _DEFAULTS,
    timeout: float = _CONNECT_TIMEOUT,  # noqa: ASYNC109 - one deadline over TCP and handshake
    suites: tuple[int, ...] = PRODUCTION,
    known: KnownCertificates | None = None,
    own_dials: OwnDials | None = None,
) -> SecureStream[PeerT]:
    """Connect and authenticate; one round trip after TCP's own.

    The responder's verdict on this side's certificate arrives later, as `PeerRefused` from
    `receive` or `send`.

    `suites` is the policy (`rossec.channel.edhoc.suites.POST_QUANTUM`). With `known`, certificates
    of known peers are named by a hash; after error 3 the handshake is repeated by value.
    `own_dials`: this node means to reach itself (`Connection.initiator`).

    Raises:
        PeerUnreachable: no TCP connection.
        PlainPeer: a plain ROS node answered.
        ChannelError: the handshake failed; the leaf says how.
    """

    def core(*, request_x5t: bool) -> Connection[PeerT]:
        return Connection.initiator(
            credentials,
            verify,
            random=secrets.token_bytes,
            now=wall_clock(),
            opening=opening,
            suites=suites,
            limits=limits,
            known=known,
            request_x5t=request_x5t,
            own_dials=own_dials,
        )

    if known is None:
        return await _handshake(await _dial(host, port, timeout), partial(core, request_x5t=False))
    request_x5t = known.knows_address((host, port))
    try:
        stream = await _handshake(
            await _dial(host, port, timeout), partial(core, request_x5t=request_x5t)
        )
    except (HandshakeFailed, PeerRefused) as error:
        # Any failure of a handshake by hash may be due to the hash.
        if isinstance(error, PeerCredentialUnknown | OwnCredentialUnknown):
            known.forget_introductions()
        elif not request_x5t or isinstance(error, HandshakeTimeout):
            raise
        by_value = partial(core, request_x5t=False)
        stream = await _handshake(await _dial(host, port, timeout), by_value)
    known.note_address((host, port))
    return stream


async def _handshake(
    sock: socket.socket, core: Callable[[], Connection[PeerT]]
) -> SecureStream[PeerT]:
    ready: asyncio.Future[SecureStream[PeerT]] = asyncio.get_running_loop().create_future()

    def on_authenticated(driver: Driver[PeerT], peer: PeerT) -> None:
        if not ready.done():
            ready.set_result(SecureStream(driver, peer))

    def on_end(_: Driver[PeerT], error: ChannelError) -> None:
        if not ready.done():
            ready.set_exception(error)

    try:
        driver = Driver(core(), sock, sock.getpeername()[0], on_authenticated, on_end)
    except OSError as error:
        sock.close()
        text = f"the connection was reset at once: {error}"
        raise PeerUnreachable(
            text, "the peer is overloaded, or something on the path resets connections"
        ) from error
    except BaseException:
        sock.close()
        raise
    try:
        return await ready
    except BaseException:
        driver.abort(ChannelClosed("the caller no longer waits for the connection"))
        raise


async def _dial(host: str, port: int, timeout: float) -> socket.socket:  # noqa: ASYNC109 - passed on by `connect`
    try:
        return await dial(host, port, timeout)
    except (OSError, TimeoutError, ValueError, IndexError, OverflowError) as error:
        # An invalid host or port: UnicodeError, IndexError and so on, by Python version.
        reason = "it does not answer" if isinstance(error, TimeoutError) else str(error)
        raise PeerUnreachable(
            f"cannot connect to {host} port {port}: {reason}",
            "is the peer running, and ROS_HOSTNAME or ROS_IP right on its side? If it is the"
            " master: start it with rossec master, and check ROS_MASTER_URI here",
        ) from error
