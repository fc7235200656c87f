"""Connecting: TCP over IPv4 or IPv6, whichever answers first, then the handshake."""

import asyncio
import secrets
import socket
from typing import Final

from rossec.channel.connection import Connection
from rossec.channel.credentials import OwnCredential, PeerT, Verify
from rossec.channel.opening import Flavour
from rossec.channel.records import Limits
from rossec.errors import ChannelClosed, ChannelError, PeerUnreachable
from rossec.net.dial import dial
from rossec.net.driver import Driver, wall_clock
from rossec.net.secure import SecureStream

_CONNECT_TIMEOUT: Final = 10.0
_DEFAULTS: Final = Limits()


async def connect(
    host: str,
    port: int,
    credentials: OwnCredential,
    verify: Verify[PeerT],
    *,
    opening: Flavour = Flavour.TCPROS,
    limits: Limits = _DEFAULTS,
    timeout: float = _CONNECT_TIMEOUT,  # noqa: ASYNC109 - one deadline over TCP and handshake
) -> SecureStream[PeerT]:
    """Connect and authenticate; one round trip after TCP's own.

    The responder's verdict on this side's certificate arrives later, as `PeerRefused` from
    `receive` or `send`.

    Raises:
        PeerUnreachable: no TCP connection.
        PlainPeer: a plain ROS node answered.
        ChannelError: the handshake failed; the leaf says how.
    """
    loop = asyncio.get_running_loop()
    ready: asyncio.Future[SecureStream[PeerT]] = loop.create_future()

    def on_authenticated(driver: Driver[PeerT], peer: PeerT) -> None:
        if not ready.done():
            ready.set_result(SecureStream(driver, peer))

    def on_end(_: Driver[PeerT], error: ChannelError) -> None:
        if not ready.done():
            ready.set_exception(error)

    sock = await _reach(host, port, timeout)
    core = Connection[PeerT].initiator(
        credentials,
        verify,
        random=secrets.token_bytes,
        now=wall_clock(),
        opening=opening,
        limits=limits,
    )
    driver = Driver(core, sock, sock.getpeername()[0], on_authenticated, on_end)
    try:
        return await ready
    except BaseException:
        driver.abort(ChannelClosed("nobody waits for the connection any more"))
        raise


async def _reach(host: str, port: int, timeout: float) -> socket.socket:  # noqa: ASYNC109 - passed on by `connect`
    try:
        async with asyncio.timeout(timeout):
            return await dial(host, port)
    except (OSError, TimeoutError) as error:
        reason = "it does not answer" if isinstance(error, TimeoutError) else str(error)
        raise PeerUnreachable(
            f"cannot connect to {host} port {port}: {reason}",
            "is the peer running, and ROS_HOSTNAME or ROS_IP right on its side?",
        ) from error
