"""The live connections of this process, so that those can be cut which must end."""

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
    """A connection admitted by `decision`; `guard` treats its messages, if anything does."""

    def __init__(
        self, stream: AuthenticatedPeer, decision: Decision, guard: Guard | None = None
    ) -> None:
        self.stream = stream
        self.decision = decision
        self.guard = guard
        self.ends = min(decision.expires, stream.peer.not_after)


class PlainConnection:
    """A connection that `allow_plain` names: nothing of it is judged, and it does not end."""

    guard = None
    ends = float("inf")


class LiveConnections:
    """All links, and how many connections each peer holds; threads share it."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._cuts: dict[LiveConnection, Callable[[], None]] = {}
        self._held: Counter[bytes | str] = Counter()
        self._holders: dict[object, bytes | str] = {}
        self._peers: dict[object, tuple[Identity, Callable[[], None]]] = {}

    def add(self, link: LiveConnection, cut: Callable[[], None]) -> None:
        """Watch over `link`; `cut` ends it at once, from any thread."""
        with self._lock:
            self._cuts[link] = cut

    def discard(self, link: LiveConnection) -> None:
        """The connection is gone."""
        with self._lock:
            self._cuts.pop(link, None)

    def admit(self, key: object, peer: Identity, cut: Callable[[], None]) -> None:
        """Count a connection that `peer` made; `forget` it when it is over.

        Raises:
            LimitExceeded: it has too many already (attack N8).
        """
        with self._lock:
            self._count(key, peer.thumbprint, peer.name)
            self._peers[key] = peer, cut

    def admit_plain(self, key: object, address: str) -> None:
        """Count a connection that is plain: all we know of such a peer is its address.

        Raises:
            LimitExceeded: it has too many already.
        """
        with self._lock:
            self._count(key, address, address)

    def _count(self, key: object, holder: bytes | str, name: str) -> None:
        if self._held[holder] >= PEER_CONNECTIONS:
            raise LimitExceeded(f"{name} has {PEER_CONNECTIONS} connections already")
        self._held[holder] += 1
        self._holders[key] = holder

    def forget(self, key: object) -> None:
        """A counted connection is over; others are not counted and change nothing."""
        with self._lock:
            self._peers.pop(key, None)
            holder = self._holders.pop(key, None)
            if holder is not None:
                self._held[holder] -= 1
                if self._held[holder] <= 0:
                    del self._held[holder]

    def must_end(
        self, why: Callable[[LiveConnection], str | None]
    ) -> list[tuple[LiveConnection, str]]:
        """Cut every link for which `why` has a reason, and forget it; returns them."""
        with self._lock:
            links = list(self._cuts.items())
        ended = []
        for link, cut in links:
            reason = why(link)
            if reason is not None:
                self.discard(link)
                cut()
                ended.append((link, reason))
        return ended

    def cut_peers(self, revoked: Callable[[Identity], bool]) -> None:
        """Cut every connection that a revoked peer made, whatever it is used for."""
        with self._lock:
            peers = list(self._peers.values())
        for peer, cut in peers:
            if revoked(peer):
                cut()

    def streams(self) -> list[AuthenticatedPeer]:
        """The connections of all links."""
        with self._lock:
            return [link.stream for link in self._cuts]

    def __len__(self) -> int:
        with self._lock:
            return len(self._cuts)

    @property
    def soonest(self) -> int | None:
        """When the first link expires."""
        with self._lock:
            return min((link.ends for link in self._cuts), default=None)
