"""The connections of one identity: how many a peer may have, and what cuts them.

A connection is in the table before it is checked once more, and checked before data passes: a
revocation that arrives while it is admitted finds it there, or is found by the check. Thread-safe;
a connection is cut with no lock held. What a form of a node adds is the stream.
"""

import logging
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from functools import partial
from threading import Lock
from typing import Any, Final, Generic, NamedTuple

from ca.certificates import Identity
from ca.domains.aliases import shown
from ca.domains.standing import Standing
from ca.errors import NotAdmitted
from rossec import clock
from rossec.errors import ChannelClosed, LimitExceeded
from rossec.net.aio import SecureStream
from rossec.net.aio.accepted import Handler
from rossec.participant.authorized import AuthorizedConnection, StreamT
from rossec.participant.renewed_grants import RenewedGrants
from rossec.ros.names import MASTER

PEER_CONNECTIONS: Final = 256  # of one identity, one for each topic or service: rosbag uses all
UNSHOWN_CONNECTIONS: Final = 32
"""Of those, the ones by which no grant was shown (yet): each is for a header, or a short call."""

_log = logging.getLogger("rossec.node")


def _source(peer: Identity) -> bytes | str:
    """What a limit on connections is for: the key, of a foreigner the domain."""
    return f"domain {peer.domain}" if peer.is_foreign else peer.thumbprint


class _Accepted(NamedTuple):
    """A connection that a peer made, authorized or not; a plain peer is an address."""

    source: bytes | str
    peer: Identity | str
    abort: Callable[[str], None]
    shown: bool = False  # by a grant that authorized it


class ConnectionTable(Generic[StreamT]):
    """The connections of one identity.

    Args:
        standing: what ends them.
        lock: held while `standing` is read, if threads share it.
        most: how many connections one peer may have made (N8); None: `PEER_CONNECTIONS`.
        master: the name of the own master, which may have more.

    Attributes:
        renewed: judges what peers present on open connections; None: no connection takes renewals.
    """

    def __init__(
        self,
        standing: Standing,
        lock: AbstractContextManager[object] = nullcontext(),  # noqa: B008 - has no state
        most: int | None = None,
        master: str = MASTER,
    ) -> None:
        self._standing = standing
        self._standing_lock = lock
        self._most = most
        self._master = master
        self._lock = Lock()  # never held together with the other one
        self._accepted: dict[object, _Accepted] = {}
        self._authorized: set[AuthorizedConnection[StreamT, Any]] = set()
        self._closed: str | None = None
        self.renewed: RenewedGrants | None = None

    # -- what peers connect

    def bounded(self, handler: Handler[Identity]) -> Handler[Identity]:
        """Call `handler` for the connections that `accept` admits.

        The master may have more: one for each program, of which a sidecar's identity has many.
        """

        async def serve_one(stream: SecureStream[Identity]) -> None:
            try:
                self.accept(
                    stream, stream.peer, stream.abort, limited=stream.peer.name != self._master
                )
            except LimitExceeded:
                _log.warning("%s has too many connections", shown(stream.peer.name))
                stream.abort("too many connections of one identity")
                return
            stream.when_closed(partial(self.forget, stream))  # one that lingers counts
            await handler(stream)

        return serve_one

    def accept(
        self,
        key: object,
        peer: Identity | str,
        abort: Callable[[str], None],
        *,
        limited: bool = True,
    ) -> None:
        """Count a connection of `peer` until `forget` is called with the same key.

        A foreign authority certifies any number of keys, so its domain counts as one peer.

        Raises:
            LimitExceeded: it has too many already, or too many that are not authorized.
        """
        source, name = (peer, peer) if isinstance(peer, str) else (_source(peer), peer.name)
        most = PEER_CONNECTIONS if self._most is None else self._most
        with self._lock:
            if limited:
                same = [each for each in self._accepted.values() if each.source == source]
                if len(same) >= most:
                    raise LimitExceeded(f"{shown(name)} has {most} connections already")
                # Who has shown a grant may open many at once, as rosbag does for each topic. A
                # plain peer has none to show, and is named by the program.
                has_shown = isinstance(peer, str) or any(each.shown for each in same)
                if not has_shown and len(same) >= UNSHOWN_CONNECTIONS:
                    raise LimitExceeded(
                        f"{shown(name)} has {UNSHOWN_CONNECTIONS} connections without a grant"
                    )
            self._accepted[key] = _Accepted(source, peer, abort)

    def forget(self, key: object) -> None:
        """Stop counting a connection; one that is not counted is ignored."""
        with self._lock:
            self._accepted.pop(key, None)

    # -- what is authorized

    def __iter__(self) -> Iterator[AuthorizedConnection[StreamT, Any]]:
        with self._lock:
            return iter(tuple(self._authorized))

    @property
    def domains(self) -> frozenset[str]:
        """The trust domains of the peers that are connected."""
        with self._lock:
            peers = [each.peer for each in self._accepted.values()]
            peers += [each.stream.peer for each in self._authorized]
        return frozenset(peer.domain for peer in peers if not isinstance(peer, str))

    @property
    def next_expiry(self) -> int | None:
        """When the first connection expires."""
        return min((connection.ends for connection in self), default=None)

    def add(self, connection: AuthorizedConnection[StreamT, Any]) -> None:
        """Add a connection; no data may have passed yet.

        Raises:
            ChannelClosed: it is not allowed any more; it is not added.
        """
        with self._lock:
            self._authorized.add(connection)
            accepted = self._accepted.get(connection.stream)
            if accepted is not None:
                self._accepted[connection.stream] = accepted._replace(shown=True)
        try:
            self.check(connection)
        except BaseException:
            self.discard(connection)
            raise
        if self.renewed is not None:
            self.renewed.opened(connection, self._renewed)

    def _renewed(self, connection: AuthorizedConnection[StreamT, Any]) -> None:
        """The peer's certificate or grants were renewed: what they need may be revoked here."""
        with self._lock:
            accepted = self._accepted.get(connection.stream)
            if accepted is not None:
                renewed = accepted._replace(peer=connection.stream.peer)
                self._accepted[connection.stream] = renewed
        with suppress(ChannelClosed):
            self.check(connection)

    def discard(self, connection: AuthorizedConnection[StreamT, Any]) -> bool:
        """The connection is gone; returns whether it was in the table."""
        with self._lock:
            known = connection in self._authorized
            self._authorized.discard(connection)
            return known

    @contextmanager
    def track(self, connection: AuthorizedConnection[StreamT, Any]) -> Iterator[None]:
        """Keep a connection in the table while the block runs; raises as `add`."""
        self.add(connection)
        try:
            yield
        finally:
            self.discard(connection)

    def check(self, connection: AuthorizedConnection[StreamT, Any]) -> None:
        """Return while the connection may stay open.

        Raises:
            ChannelClosed: it must end, and is aborted.
        """
        now = clock.now()
        with self._standing_lock:
            reason = connection.termination_reason(self._standing, now)
        if self._closed is None and (reason is None or self._continues(connection, now)):
            return
        reason = self._closed or reason or ""
        connection.stream.abort(reason)
        raise ChannelClosed(reason)

    # -- what must end

    def cut_ended(self, now: int) -> None:
        """Cut every connection that must end at `now`, and every one of a revoked identity.

        Also those of a domain that is not trusted any more, authorized or not.
        """
        connections = tuple(self)
        with self._lock:
            accepted = tuple(self._accepted.values())
        with self._standing_lock:
            ended = [(each, each.termination_reason(self._standing, now)) for each in connections]
            refused = [(each, self._refusal(each.peer, now)) for each in accepted]
        for connection, reason in ended:
            if reason is None or self._continues(connection, now):
                continue
            if self.discard(connection):
                connection.stream.abort(reason)
                name, right = connection.stream.peer.name, connection.decision.name
                _log.warning(
                    "closed the connection with %s (%s): %s", shown(name), shown(right), reason
                )
        for each, reason in refused:
            if reason is not None:
                each.abort(reason)
        if self.renewed is not None:
            self.renewed.retry(self, now)

    def _continues(self, connection: AuthorizedConnection[StreamT, Any], now: int) -> bool:
        """Whether a connection that must end goes on with what its peer presented meanwhile."""
        if self.renewed is None or not self.renewed.continues(connection, now):
            return False
        with self._standing_lock:
            return connection.termination_reason(self._standing, now) is None

    def _refusal(self, peer: Identity | str, now: int) -> str | None:
        """Why no connection with `peer`, authorized or not, may stand; None: it may."""
        if isinstance(peer, str):
            return None
        domains = dict.fromkeys((self._standing.anchors.own.domain, peer.domain))
        if not all(self._standing.revoked(each).isdisjoint(peer.keys) for each in domains):
            return "the peer's identity is revoked"
        try:
            self._standing.check_trust(peer, now)
        except NotAdmitted as error:
            return str(error)
        return None

    def close(self, reason: str) -> None:
        """Cut every connection, and admit none any more: nothing would cut it."""
        self._closed = reason
        for connection in self:
            self.discard(connection)
            connection.stream.abort(reason)
