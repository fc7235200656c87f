"""The channel as one identity speaks it: it connects to peers, and listens for them.

A shell. Whoever answers is checked before anything is said.
"""

from typing import Final

from ca.certificates import Identity, TrustAnchor
from ca.errors import HintedError, RevocationsStale
from rossec import clock
from rossec.channel.edhoc.credentials import OwnCredential
from rossec.channel.edhoc.known import KnownCertificates
from rossec.channel.edhoc.own_dials import OwnDials
from rossec.channel.opening import WireProtocol
from rossec.channel.records import ChannelLimits
from rossec.errors import HangUp
from rossec.net.aio import SecureStream, connect
from rossec.net.aio.server import Handler, SecureServer, serve
from rossec.net.bounds import ACCEPTED, DIALLED, PREAUTH_LIMIT
from rossec.net.halfopen import HalfOpenCount
from rossec.participant.access import Access
from rossec.ros.header import MESSAGE_LIMIT
from rossec.ros.settings import is_loopback
from rossec.ros.xmlrpc import BODY_LIMIT
from rossec.sidecar.core.endpoints import Endpoint
from rossec.sidecar.loopback_port import bind_free_port

# Peers send headers and requests; what programs send leaves in small units.
_ACCEPTED: Final = {
    **ACCEPTED,
    WireProtocol.TCPROS: ChannelLimits(
        unit=MESSAGE_LIMIT + BODY_LIMIT, preauth_limit=PREAUTH_LIMIT
    ),
}


class PeerConnector:
    """Acts with `credentials`, for peers that `anchor` vouches for and `access` knows as alive.

    Args:
        half_open: what strangers have begun at any door of this process.
    """

    def __init__(
        self,
        credentials: OwnCredential,
        anchor: TrustAnchor,
        access: Access,
        suites: tuple[int, ...],
        half_open: HalfOpenCount,
    ) -> None:
        self._half_open = half_open
        self._credentials = credentials
        self._anchor = anchor
        self._access = access
        self._suites = suites
        self._known = KnownCertificates()
        self._own_dials = OwnDials()

    async def dial(
        self, remote: Endpoint, *, allow_stale: bool = False, own_identity: bool = False
    ) -> SecureStream[Identity]:
        """Connect to a peer whose identity holds.

        Args:
            own: it is a program of this same identity: nobody else will do.
            news: it brings what is revoked, so that it may be met before anybody knows.

        Raises:
            HangUp: it does not hold, or nobody knows.
        """
        stream = await self._connect(remote, self._own_dials if own_identity else None)
        try:
            self._access.check_peer(stream.peer, clock.now())
        except HintedError as error:
            if not (allow_stale and isinstance(error, RevocationsStale)):
                stream.abort("the peer's identity does not hold")
                raise HangUp(str(error), error.hint) from error
        return stream

    async def _connect(
        self, remote: Endpoint, own_dials: OwnDials | None
    ) -> SecureStream[Identity]:
        return await connect(
            remote.host, remote.port, self._credentials, self._anchor.verify,
            opening=remote.protocol, limits=DIALLED[remote.protocol],
            suites=self._suites, known=self._known, own_dials=own_dials,
        )  # fmt: skip

    def listen(
        self, handler: Handler[Identity], host: str, protocol: WireProtocol
    ) -> SecureServer[Identity]:
        """Listen, on loopback alone when `host`, where peers are told to come, is loopback.

        The port is named when it is bound, so that the kernel keeps it while the server rests.
        """
        bind = host if is_loopback(host) else None
        return bind_free_port(
            lambda port: serve(
                handler, bind, port, self._credentials, self._anchor.verify,
                accept={protocol}, limits=_ACCEPTED[protocol], half_open=self._half_open,
                suites=self._suites, known=self._known, own_dials=self._own_dials,
            )
        )  # fmt: skip
