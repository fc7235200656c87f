"""`SecureContext`: what one identity brings to its connections, as `ssl.SSLContext` does for TLS.

`connect` and `serve` of `rossec.net.aio` and `SecureSocket` of `rossec.net.threads` take one. It waits for
nothing and imports neither: programs with threads need no asyncio.

A connection does not survive a fork. Parent and child would both hold its keys and counters, and seal two
different records under one nonce: with AES-GCM that gives both plaintexts and the authentication key away
(RFC 5116, 5.1.1). So the child forgets what it inherited; the parent's connections go on. `subprocess` and
multiprocessing's `spawn` run no Python between fork and `exec`: programs started so are safe.
"""

import os
import secrets
from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field
from threading import Lock
from typing import Final, Generic, Protocol
from weakref import WeakSet

from rossec import clock
from rossec.channel.connection import Connection, PresentsIdentity
from rossec.channel.edhoc.credentials import (
    KnownCertificates,
    LiveCredentials,
    OwnCredential,
    PeerT,
    Renews,
    SelfConnections,
    Verify,
)
from rossec.channel.edhoc.handshake import EdhocConfig
from rossec.channel.edhoc.suites import OFFERED_SUITES
from rossec.channel.opening import WireProtocol
from rossec.channel.records import ChannelLimits
from rossec.net.limits import ACCEPTED, DIALLED, HalfOpenCount, HalfOpenLimits


class OpenConnections:
    # Thread-safe. Held weakly: a connection that has ended needs no entry.
    def __init__(self) -> None:
        self._lock = Lock()
        self._streams: WeakSet[PresentsIdentity] = WeakSet()
        self._newest: Sequence[bytes] = ()

    def add(self, stream: PresentsIdentity) -> None:
        with self._lock:
            self._streams.add(stream)
            newest = self._newest
        if newest:
            stream.present_identity(newest)

    def present(self, chain: Sequence[bytes]) -> None:
        with self._lock:
            self._newest = chain
            streams = list(self._streams)
        for stream in streams:
            stream.present_identity(chain)


@dataclass(frozen=True, eq=False)
class SecureContext(Generic[PeerT]):
    """The credentials and the policy of one identity; its connections and ports share it. `known` is for
    asyncio only: `SecureSocket` does not repeat a handshake by value."""

    credentials: OwnCredential  # `LiveCredentials` are read at each handshake
    verify: Verify[PeerT]  # of every peer
    _: KW_ONLY
    suites: tuple[int, ...] = OFFERED_SUITES  # the policy (`rossec.channel.edhoc.suites.POST_QUANTUM`)
    known: KnownCertificates | None = None  # with it, known peers' certificates are named by a hash (x5t)
    self_connections: SelfConnections = field(
        default_factory=SelfConnections
    )  # to itself, which its ports accept
    dial_limits: Mapping[WireProtocol, ChannelLimits] = field(default_factory=lambda: DIALLED)
    accept_limits: Mapping[WireProtocol, ChannelLimits] = field(default_factory=lambda: ACCEPTED)
    half_open: HalfOpenCount = field(
        default_factory=lambda: HalfOpenCount(HalfOpenLimits())
    )  # all ports share it
    renews: Renews[PeerT] | None = None  # with it, renewed certificates and grants are taken
    open_streams: OpenConnections = field(default_factory=OpenConnections)

    def __post_init__(self) -> None:
        if isinstance(self.credentials, LiveCredentials) and self.renews is not None:
            self.credentials.on_change.append(self.open_streams.present)

    def initiator(
        self, protocol: WireProtocol, *, to_itself: bool = False, request_x5t: bool = False
    ) -> Connection[PeerT]:
        """The core of a connection that this side made; as `Connection.initiator`. `to_itself`: the peer must
        be this identity in this process; else it must be another one."""
        dials = self.self_connections if to_itself else None
        config = self._config(dials, request_x5t=request_x5t)
        limits = self.dial_limits[protocol]
        return self._kept(Connection.initiator(config, now=clock.now(), opening=protocol, limits=limits))

    def responder(self, protocol: WireProtocol) -> Connection[PeerT]:
        """The core of an accepted connection, which must open in `protocol`."""
        config, limits = self._config(self.self_connections), self.accept_limits[protocol]
        return self._kept(Connection.responder(config, now=clock.now(), accept=(protocol,), limits=limits))

    def _config(
        self, self_connections: SelfConnections | None, *, request_x5t: bool = False
    ) -> EdhocConfig[PeerT]:
        return EdhocConfig(
            self.credentials,
            self.verify,
            secrets.token_bytes,
            self.suites,
            known=self.known,
            request_x5t=request_x5t,
            self_connections=self_connections,
            renews=self.renews,
        )

    def _kept(self, connection: Connection[PeerT]) -> Connection[PeerT]:
        if self.renews is not None:
            connection.streams = self.open_streams
        return connection


class Inherited(Protocol):
    def abandon(self) -> None: ...


_watched: Final[WeakSet[Inherited]] = WeakSet()


def forget_in_children(inherited: Inherited) -> None:
    """Have every forked child abandon it, before other code of the child runs."""
    _watched.add(inherited)


def _in_child() -> None:
    try:
        for inherited in list(_watched):
            inherited.abandon()
    except BaseException:  # noqa: BLE001 - better no child than one that holds its parent's keys
        os._exit(os.EX_SOFTWARE)


os.register_at_fork(after_in_child=_in_child)
