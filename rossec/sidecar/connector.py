"""The secure channel of one identity: connects to peers and listens for them.

A shell. A peer is checked before anything is sent to it.
"""

from typing import Final

from ca.certificates import Identity
from ca.errors import HintedError, RevocationsStale
from rossec import clock
from rossec.channel.opening import WireProtocol
from rossec.channel.records import ChannelLimits
from rossec.errors import HangUp
from rossec.net.aio import SecureContext, SecureStream, connect
from rossec.net.aio.accepted import Handler
from rossec.net.aio.server import SecureServer, serve
from rossec.net.bounds import ACCEPTED, PREAUTH_LIMIT
from rossec.participant.access import Access
from rossec.ros.header import MESSAGE_LIMIT
from rossec.ros.settings import is_loopback
from rossec.ros.xmlrpc import BODY_LIMIT
from rossec.sidecar.core.endpoints import Endpoint
from rossec.sidecar.loopback_port import bind_free_port

# Peers send headers and requests; what programs send leaves in small units.
ACCEPT_LIMITS: Final = {
    **ACCEPTED,
    WireProtocol.TCPROS: ChannelLimits(
        unit=MESSAGE_LIMIT + BODY_LIMIT, preauth_limit=PREAUTH_LIMIT
    ),
}


class PeerConnector:
    """Authenticates with `context`; the identities of peers must be valid for `access`."""

    def __init__(self, context: SecureContext[Identity], access: Access) -> None:
        self._context = context
        self._access = access

    async def dial(
        self, remote: Endpoint, *, allow_stale: bool = False, own_identity: bool = False
    ) -> SecureStream[Identity]:
        """Connect to a peer with a valid identity.

        Args:
            allow_stale: accept stale revocation data: the master provides fresh data.
            own_identity: the peer must be a program of this identity.

        Raises:
            HangUp: the identity is invalid, or its revocation status unknown.
        """
        stream = await connect(
            remote.host, remote.port, self._context, remote.protocol, to_itself=own_identity
        )
        try:
            self._access.check_peer(stream.peer, clock.now())
        except HintedError as error:
            if not (allow_stale and isinstance(error, RevocationsStale)):
                stream.abort("the peer's identity is invalid")
                raise HangUp(str(error), error.hint) from error
        return stream

    def listen(
        self, handler: Handler[Identity], host: str, protocol: WireProtocol
    ) -> SecureServer[Identity]:
        """Listen; on loopback alone if `host`, the advertised address, is loopback.

        The port is bound explicitly, so that the kernel reserves it while the server is suspended.
        """
        bind = host if is_loopback(host) else None
        return bind_free_port(lambda port: serve(handler, bind, port, self._context, protocol))
