"""The live connections of an identity: how many it accepts of a peer, and when one must end.

The owner checks each connection with `termination_reason` and closes it. An authorized connection
was admitted by a `Decision`; every kind of node shares these rules.
"""

import logging
from functools import partial
from typing import Final, Protocol

from ca.certificates import Identity
from ca.errors import RevocationsStale, Revoked
from ca.revocation.state import Revocations
from grants.decision import Decision
from rossec.net.aio import SecureStream
from rossec.net.aio.server import Handler
from rossec.participant.slave_rights import MASTER

PEER_CONNECTIONS: Final = 256  # of one identity, one for each topic or service: rosbag uses all

# Existing connections survive missing timestamps this long; new ones are refused at once.
STALE_GRACE: Final = 60

_log = logging.getLogger("rossec.node")


class AuthenticatedPeer(Protocol):
    """A stream whose peer is authenticated."""

    @property
    def peer(self) -> Identity:
        """Identity of the peer."""


class AuthorizedPeer(Protocol):
    """A connection admitted by `decision`; grant or certificate expire at `ends` (seconds)."""

    decision: Decision
    ends: int

    @property
    def stream(self) -> AuthenticatedPeer:
        """The connection."""


class AuthorizedConnection(AuthorizedPeer, Protocol):
    """A connection of the built-in node, which its watchdog can close."""

    @property
    def stream(self) -> SecureStream[Identity]:
        """The connection."""


class AcceptedConnections:
    """The accepted connections of an identity, bounded per peer."""

    def __init__(self) -> None:
        self._streams: set[SecureStream[Identity]] = set()

    def bounded(self, handler: Handler[Identity]) -> Handler[Identity]:
        """Call `handler` for at most `PEER_CONNECTIONS` connections of one identity (N8).

        The master may have more: one for each program, of which a sidecar's identity has many.
        """

        async def serve_one(stream: SecureStream[Identity]) -> None:
            if stream.peer.name != MASTER and self._count(stream.peer) >= PEER_CONNECTIONS:
                _log.warning("%s has too many connections", stream.peer.name)
                stream.abort("too many connections of one identity")
                return
            self._streams.add(stream)  # until its socket is closed: one that lingers counts
            stream.when_closed(partial(self._streams.discard, stream))
            await handler(stream)

        return serve_one

    def _count(self, peer: Identity) -> int:
        return sum(other.peer.thumbprint == peer.thumbprint for other in self._streams)

    def abort_revoked(self, revoked: frozenset[bytes]) -> None:
        """Close every connection of a revoked key, for whatever purpose it was accepted."""
        for stream in tuple(self._streams):
            if not revoked.isdisjoint(stream.peer.keys):
                stream.abort("the peer's identity is revoked")


def termination_reason(
    connection: AuthorizedPeer, revocations: Revocations, now: int
) -> str | None:
    """Why `connection` must be closed now; None while it may stay open.

    Missing revocation data closes it after `STALE_GRACE`, unless every permission used says
    `on_stale: keep`: an emergency stop must not depend on it. A revocation always closes it.
    """
    if now >= connection.ends:
        return "its grant or its certificate has expired"
    errors = {entry: _revocation_error(entry, revocations, now) for entry in _entries(connection)}
    for error in errors.values():  # all of them before staleness, which the first may have as well
        if isinstance(error, Revoked):
            return str(error)
    if connection.decision.keep_when_stale:
        return None
    for entry, error in errors.items():
        if error is not None and now >= revocations.status_valid_until(entry) + STALE_GRACE:
            return str(error)
    return None


def _entries(connection: AuthorizedPeer) -> tuple[bytes, ...]:
    return (*connection.stream.peer.keys, *connection.decision.grant_ids)


def _revocation_error(
    entry: bytes, revocations: Revocations, now: int
) -> Revoked | RevocationsStale | None:
    try:
        revocations.check(entry, now)
    except (Revoked, RevocationsStale) as error:
        return error
    return None
