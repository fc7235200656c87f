"""The live connections of this process, so that they can be closed when a right ends."""

from collections import Counter
from collections.abc import Callable
from threading import Lock
from typing import Final

from ca.certificates import Identity
from grants.decision import Decision
from grants.guard import Guard
from rossec.errors import LimitExceeded
from rossec.participant.connections import AuthenticatedPeer

PEER_CONNECTIONS: Final = 64  # of one identity: one for each topic and service it uses here


class LiveConnection:
    """A connection admitted by `decision`; `guard`, if any, filters its messages."""

    def __init__(
        self, stream: AuthenticatedPeer, decision: Decision, guard: Guard | None = None
    ) -> None:
        self.stream = stream
        self.decision = decision
        self.guard = guard
        self.ends = min(decision.expires, stream.peer.not_after)


class PlainConnection:
    """A connection that `allow_plain` names: not authorized, and without an expiry."""

    guard = None
    ends = float("inf")


class LiveConnections:
    """All live connections, and how many each peer has; thread-safe."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._aborts: dict[LiveConnection, Callable[[], None]] = {}
        self._counts: Counter[bytes | str] = Counter()
        self._counted: dict[object, bytes | str] = {}
        self._peers: dict[object, tuple[Identity, Callable[[], None]]] = {}

    def add(self, connection: LiveConnection, abort: Callable[[], None]) -> None:
        """Add `connection`; `abort` ends it at once, from any thread."""
        with self._lock:
            self._aborts[connection] = abort

    def discard(self, connection: LiveConnection) -> None:
        """The connection is gone."""
        with self._lock:
            self._aborts.pop(connection, None)

    def admit(self, key: object, peer: Identity, abort: Callable[[], None]) -> None:
        """Count a connection that `peer` made; call `forget` when it is closed.

        Raises:
            LimitExceeded: it has too many already (attack N8).
        """
        with self._lock:
            self._count(key, peer.thumbprint, peer.name)
            self._peers[key] = peer, abort

    def admit_plain(self, key: object, address: str) -> None:
        """Count a plain connection, by its address: such a peer has no identity.

        Raises:
            LimitExceeded: it has too many already.
        """
        with self._lock:
            self._count(key, address, address)

    def _count(self, key: object, holder: bytes | str, name: str) -> None:
        if self._counts[holder] >= PEER_CONNECTIONS:
            raise LimitExceeded(f"{name} has {PEER_CONNECTIONS} connections already")
        self._counts[holder] += 1
        self._counted[key] = holder

    def forget(self, key: object) -> None:
        """Stop counting a connection; one that is not counted is ignored."""
        with self._lock:
            self._peers.pop(key, None)
            holder = self._counted.pop(key, None)
            if holder is not None:
                self._counts[holder] -= 1
                if self._counts[holder] <= 0:
                    del self._counts[holder]

    def close_ended(
        self, end_reason: Callable[[LiveConnection], str | None]
    ) -> list[tuple[LiveConnection, str]]:
        """Close every connection for which `end_reason` has a reason; returns them."""
        with self._lock:
            connections = list(self._aborts.items())
        ended = []
        for connection, abort in connections:
            reason = end_reason(connection)
            if reason is not None:
                self.discard(connection)
                abort()
                ended.append((connection, reason))
        return ended

    def close_revoked(self, revoked: Callable[[Identity], bool]) -> None:
        """Close every connection that a revoked peer made, whatever it is used for."""
        with self._lock:
            peers = list(self._peers.values())
        for peer, abort in peers:
            if revoked(peer):
                abort()

    def streams(self) -> list[AuthenticatedPeer]:
        """The streams of all connections."""
        with self._lock:
            return [connection.stream for connection in self._aborts]

    def __len__(self) -> int:
        with self._lock:
            return len(self._aborts)

    @property
    def next_expiry(self) -> int | None:
        """When the first connection expires."""
        with self._lock:
            return min((connection.ends for connection in self._aborts), default=None)
