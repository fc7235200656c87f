"""The accepted connections of an identity: bounded per peer, and cut when its key is revoked.

A shell. Every kind of node shares it.
"""

import logging
from functools import partial
from typing import Final

from ca.certificates import Identity
from rossec.net.aio import SecureStream
from rossec.net.aio.server import Handler
from rossec.participant.slave_rights import MASTER

PEER_CONNECTIONS: Final = 256  # of one identity, one for each topic or service: rosbag uses all

_log = logging.getLogger("rossec.node")


class AcceptedConnections:
    """Who is connected now."""

    def __init__(self) -> None:
        self._streams: set[SecureStream[Identity]] = set()

    def bounded(self, handler: Handler[Identity]) -> Handler[Identity]:
        """Serve an entitled peer, and no more than a few connections of one identity (N8).

        The master may have more: one for each program, of which a sidecar's identity has many.
        """

        async def serve_one(stream: SecureStream[Identity]) -> None:
            if stream.peer.name != MASTER and self._count(stream.peer) >= PEER_CONNECTIONS:
                _log.warning("%s has too many connections", stream.peer.name)
                stream.abort("too many connections of one identity")
                return
            self._streams.add(stream)  # until its socket is closed: one that lingers counts
            stream.when_lost(partial(self._streams.discard, stream))
            await handler(stream)

        return serve_one

    def _count(self, peer: Identity) -> int:
        return sum(other.peer.thumbprint == peer.thumbprint for other in self._streams)

    def cut(self, revoked: frozenset[bytes]) -> None:
        """Cut every connection of a revoked key, whatever it is used for."""
        for stream in tuple(self._streams):
            if not revoked.isdisjoint(stream.peer.keys):
                stream.abort("the peer's identity is revoked")
