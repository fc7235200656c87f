"""`SecureContext`: what one identity brings to its connections, as `ssl.SSLContext` does for TLS.

`connect` and `serve` of `rossec.net.aio` and `SecureSocket` of `rossec.net.threads` take one. It
waits for nothing and imports neither: programs with threads need no asyncio.
"""

import secrets
from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, field
from typing import Generic

from rossec import clock
from rossec.channel.connection import Connection
from rossec.channel.edhoc.credentials import LiveCredentials, OwnCredential, PeerT, Renews, Verify
from rossec.channel.edhoc.known import KnownCertificates
from rossec.channel.edhoc.own_dials import OwnDials
from rossec.channel.edhoc.suites import PRODUCTION
from rossec.channel.opening import WireProtocol
from rossec.channel.records import ChannelLimits
from rossec.net.bounds import ACCEPTED, DIALLED
from rossec.net.halfopen import HalfOpen, HalfOpenCount
from rossec.net.open_streams import OpenStreams


@dataclass(frozen=True, eq=False)
class SecureContext(Generic[PeerT]):
    """The credentials and the policy of one identity; its connections and ports share it.

    Args:
        credentials: its own; `LiveCredentials` are read at each handshake.
        verify: verification of every peer.
        suites: the policy (`rossec.channel.edhoc.suites.POST_QUANTUM`).
        known: with it, certificates of known peers are named by a hash (x5t). For asyncio only:
            `SecureSocket` does not repeat a handshake by value.
        own_dials: its pending connections to itself, which its ports accept.
        dial_limits, accept_limits: of connections it makes, and of those it accepts.
        half_open: the limit that all its ports share.
        renews: with it, renewed certificates and grants are taken on open connections.
        open_streams: its open connections.
    """

    credentials: OwnCredential
    verify: Verify[PeerT]
    _: KW_ONLY
    suites: tuple[int, ...] = PRODUCTION
    known: KnownCertificates | None = None
    own_dials: OwnDials = field(default_factory=OwnDials)
    dial_limits: Mapping[WireProtocol, ChannelLimits] = field(default_factory=lambda: DIALLED)
    accept_limits: Mapping[WireProtocol, ChannelLimits] = field(default_factory=lambda: ACCEPTED)
    half_open: HalfOpenCount = field(default_factory=lambda: HalfOpenCount(HalfOpen()))
    renews: Renews[PeerT] | None = None
    open_streams: OpenStreams = field(default_factory=OpenStreams)

    def __post_init__(self) -> None:
        if isinstance(self.credentials, LiveCredentials) and self.renews is not None:
            self.credentials.on_change.append(self.open_streams.present)

    def initiator(
        self, protocol: WireProtocol, *, to_itself: bool = False, request_x5t: bool = False
    ) -> Connection[PeerT]:
        """The core of a connection that this side made; as `Connection.initiator`.

        `to_itself`: the peer must be this identity in this process; else it must be another one.
        """
        return self._kept(Connection.initiator(
            self.credentials, self.verify, random=secrets.token_bytes, now=clock.now(),
            opening=protocol, suites=self.suites, limits=self.dial_limits[protocol],
            known=self.known, request_x5t=request_x5t,
            own_dials=self.own_dials if to_itself else None, renews=self.renews,
        ))  # fmt: skip

    def responder(self, protocol: WireProtocol) -> Connection[PeerT]:
        """The core of an accepted connection, which must open in `protocol`."""
        return self._kept(Connection.responder(
            self.credentials, self.verify, random=secrets.token_bytes, now=clock.now(),
            accept=(protocol,), suites=self.suites, limits=self.accept_limits[protocol],
            known=self.known, own_dials=self.own_dials, renews=self.renews,
        ))  # fmt: skip

    def _kept(self, connection: Connection[PeerT]) -> Connection[PeerT]:
        """Of a connection that takes renewals: its stream is told of them."""
        if self.renews is not None:
            connection.streams = self.open_streams
        return connection
