"""The connections of one identity: how many a peer may have, when each must end, what cuts it.

A connection is in the table before it is checked once more, and checked before data passes: a
revocation that arrives while it is admitted finds it there, or is found by the check. Thread-safe;
a connection is cut with no lock held. What a form of a node adds is the stream.
"""

import logging
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field
from functools import partial
from itertools import product
from threading import Lock
from typing import Any, Final, Generic, NamedTuple, Protocol, TypeVar

from ca.certificates import Identity
from ca.domains.aliases import shown, split_alias
from ca.domains.served import alias_of_served
from ca.domains.standing import Standing
from ca.errors import NotAdmitted, RevocationsStale, Revoked
from grants.decision import Decision
from rossec import clock
from rossec.errors import ChannelClosed, LimitExceeded
from rossec.net.aio import SecureStream
from rossec.net.aio.accepted import Handler
from rossec.ros.names import MASTER

PEER_CONNECTIONS: Final = 256  # of one identity, one for each topic or service: rosbag uses all

# Existing connections survive missing timestamps this long; new ones are refused at once.
STALE_GRACE: Final = 60

_log = logging.getLogger("rossec.node")


class PeerStream(Protocol):
    """A stream whose peer is authenticated."""

    @property
    def peer(self) -> Identity:
        """Identity of the peer."""

    def abort(self, reason: str) -> None:
        """End it at once; from any thread, if threads share the table."""


StreamT = TypeVar("StreamT", bound=PeerStream)
GuardT = TypeVar("GuardT")


@dataclass(eq=False)
class AuthorizedConnection(Generic[StreamT, GuardT]):
    """A connection admitted by `decision`.

    Attributes:
        guard: applies the restrictions of the decision to what passes; None: nothing does here.
        ends: when the grant or the certificate of the peer expires (seconds).
    """

    stream: StreamT
    decision: Decision
    guard: GuardT
    ends: int = field(init=False)

    def __post_init__(self) -> None:
        self.ends = min(self.decision.expires, self.stream.peer.not_after)

    def termination_reason(self, standing: Standing, now: int) -> str | None:
        """Why it must be closed now; None while it may stay open.

        The peer's keys count on the own list and on that of its domain; the grants' entries also on
        that of the domain the name is of. Missing revocation data closes it after `STALE_GRACE`,
        unless every permission used says `on_stale: keep`: an emergency stop must not depend on it.
        A revocation, and the end of the trust in a domain, always close it.
        """
        if now >= self.ends:
            return "its grant or its certificate has expired"
        errors = {entry: _error_of(*entry, standing, now) for entry in self._entries(standing)}
        for error in errors.values():  # all of them before staleness, which the first may have too
            if isinstance(error, Revoked | NotAdmitted):
                return str(error)
        try:
            standing.check_trust(self.stream.peer, now)
            _check_label(self.decision, standing)
        except NotAdmitted as error:
            return str(error)
        if self.decision.keep_when_stale:
            return None
        for entry, stale in errors.items():
            if stale is not None and now >= standing.status_valid_until(*entry) + STALE_GRACE:
                return str(stale)
        return None

    def _entries(self, standing: Standing) -> Iterator[tuple[str, bytes]]:
        """What ends it when revoked, with the domain whose list says so."""
        peer, own = self.stream.peer, standing.anchors.own.domain
        of_peer = dict.fromkeys((own, peer.domain))
        of_grants = of_peer | dict.fromkeys(grant.domain for grant in self.decision.grants)
        yield from product(of_peer, peer.keys)
        yield from product(of_grants, self.decision.grant_ids)


def _error_of(
    domain: str, entry: bytes, standing: Standing, now: int
) -> Revoked | NotAdmitted | RevocationsStale | None:
    try:
        standing.check(domain, entry, now)
    except (Revoked, NotAdmitted, RevocationsStale) as error:
        return error
    return None


def _check_label(decision: Decision, standing: Standing) -> None:
    """Return while the label in an alias stands for the domain of the grants.

    What a gateway serves is of the own domain's grants, and ends with the label. Whose label it is
    then, the gateway's own connections to the origin have been cut for.
    """
    served = alias_of_served(decision.name)
    found = split_alias(decision.name if served is None else served)
    if found is None:
        return
    listed = standing.anchors.listed(found[0])
    if served is not None and listed is not None:
        return
    domain = None if listed is None else listed.entry.domain
    if any(grant.domain != domain for grant in decision.grants):
        raise NotAdmitted(f"{found[0]} is no longer the domain it was")


def _source(peer: Identity) -> bytes | str:
    """What a limit on connections is for: the key, of a foreigner the domain."""
    return f"domain {peer.domain}" if peer.is_foreign else peer.thumbprint


class _Accepted(NamedTuple):
    """A connection that a peer made, authorized or not; a plain peer is an address."""

    source: bytes | str
    peer: Identity | str
    abort: Callable[[str], None]


class ConnectionTable(Generic[StreamT]):
    """The connections of one identity.

    Args:
        standing: what ends them.
        lock: held while `standing` is read, if threads share it.
        most: how many connections one peer may have made (N8); None: `PEER_CONNECTIONS`.
        master: the name of the own master, which may have more.
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
            LimitExceeded: it has too many already.
        """
        source, name = (peer, peer) if isinstance(peer, str) else (_source(peer), peer.name)
        most = PEER_CONNECTIONS if self._most is None else self._most
        with self._lock:
            if limited and sum(other.source == source for other in self._accepted.values()) >= most:
                raise LimitExceeded(f"{shown(name)} has {most} connections already")
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
        try:
            self.check(connection)
        except BaseException:
            self.discard(connection)
            raise

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
        with self._standing_lock:
            reason = connection.termination_reason(self._standing, clock.now())
        reason = self._closed or reason
        if reason is not None:
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
            if reason is not None and self.discard(connection):
                connection.stream.abort(reason)
                name, right = connection.stream.peer.name, connection.decision.name
                _log.warning(
                    "closed the connection with %s (%s): %s", shown(name), shown(right), reason
                )
        for each, reason in refused:
            if reason is not None:
                each.abort(reason)

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
