"""A connection whose peer was authorized: under which decision, until when, what ends it, and what replaces
it.

The state of limited rights (rates) is one store for all nodes of this process: closing and reopening a node,
publishing a topic again, or reconnecting does not reset it.
"""

import logging
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from itertools import product
from threading import Lock
from typing import Any, Final, Generic, Protocol, TypeAlias, TypeVar

from ca.certificates import Identity
from ca.encoding import encode
from ca.errors import HintedError, NotAdmitted, RevocationsStale, Revoked
from ca.names import alias_of_served, shown, split_alias
from ca.revocation.trust_status import TrustStatus
from grants.decision import Decision
from grants.guard import MemoryScope, MemoryStore
from grants.limits import TokenBucket
from grants.model import Right
from rossec import clock
from rossec.channel.negotiation import GrantsPresented, IdentityRenewed, Renewal
from rossec.errors import LimitExceeded
from rossec.participant.access import HandshakeAccess
from rossec.peer_limits import printable

# Existing connections survive missing timestamps this long; new ones are refused at once.
STALE_GRACE: Final = 60
# The peer's connection takes one in 2 s, and ends beyond (0051).
PACE: Final = 3  # seconds between two presentations of this node on one connection
_HEADER: Final = 30  # seconds a connection header may be older than the connection's authorization
_RETRY: Final = 2  # seconds until what was refused is judged again; twice as long each time
_LONGEST: Final = 60
_AT_ONCE: Final = 256  # presentations of one key that are judged: one for each connection it may have
_A_SECOND: Final = 8.0
_PEERS: Final = 1024  # budgets that are kept; full ones are as good as none
_NOTHING: Final = encode([])
_OTHERS: Final = {
    Right.SUBSCRIBE: Right.PUBLISH,
    Right.PUBLISH: Right.SUBSCRIBE,
    Right.CALL: Right.PROVIDE,
    Right.PROVIDE: Right.CALL,
}
"""The right of this side on a connection, by the one of the peer."""
# Of the process: a peer that reconnects finds its bucket as it left it (0011).
_MEMORIES: Final = MemoryStore(clock.time, Lock)
_log = logging.getLogger("rossec.node")


def memory_scope(node: str) -> MemoryScope:
    return MemoryScope(_MEMORIES, (node,))


class PeerStream(Protocol):
    @property
    def peer(self) -> Identity: ...

    # Pad what is sent from now on to a multiple of so many bytes; 0: do not.
    def pad_units(self, multiple: int) -> None: ...

    # Let nothing pass any more and call nothing back: `abort` follows, and says why to whoever waits.
    def disconnect(self) -> None: ...
    def abort(self, reason: str) -> None: ...


StreamT = TypeVar("StreamT", bound=PeerStream)
GuardT = TypeVar("GuardT")


@dataclass
class Presented:
    """What was presented on one open connection."""

    by_peer: bytes = b""  # its newest grants, which may not be in force (yet); empty: none since the header
    retry_at: int | None = None  # when they are judged again; None: they were accepted, or there are none
    pause: int = 0  # seconds until they are judged once more after that
    by_self: bytes = b""  # the newest grants of this node; empty: those of its header, if any
    version: int = -1  # of this node's rights, when `by_self` was compared with them; below 0: never
    next_at: int = 0  # when this node may present again
    opened: int = field(default_factory=clock.now)


@dataclass(eq=False)
class AuthorizedConnection(Generic[StreamT, GuardT]):
    """A connection admitted by `decision`.

    `rebuild` makes the guard for another decision of the same peer, right and name; it raises a `HintedError`
    where that cannot be applied to this connection. None: it takes none.
    """

    stream: StreamT
    decision: Decision
    guard: GuardT  # applies the restrictions of the decision to what passes; None: nothing does here
    rebuild: Callable[[Decision], GuardT] | None = None
    swap: Callable[[GuardT], None] | None = None  # replaces the guard in force; None: it is the attribute
    presented: Presented = field(default_factory=Presented)  # by both sides, since it is open
    ends: int = field(init=False)  # when the grant or the certificate of the peer expires (seconds)
    entries: tuple[bytes, ...] = field(init=False)  # of a list that names the peer or one of its grants

    def __post_init__(self) -> None:
        self.update_end()
        if self.decision.pad:
            self.stream.pad_units(self.decision.pad)

    def update_end(self) -> None:
        self.ends = min(self.decision.expires, self.stream.peer.not_after)
        self.entries = *self.stream.peer.keys, *self.decision.grant_ids

    def replace(self, decision: Decision, guard: GuardT) -> None:
        """Another decision, with its guard, takes the place of the one in force.

        The guard first: a thread that sends meanwhile filters by it, and ends by either. What it
        sends is padded, if one of the two says so.
        """
        if decision.pad > self.decision.pad:
            self.stream.pad_units(decision.pad)
        if self.swap is not None:
            self.swap(guard)
        self.guard = guard
        if decision.pad < self.decision.pad:
            self.stream.pad_units(decision.pad)
        self.decision = decision
        self.update_end()

    def termination_reason(self, trust_status: TrustStatus, now: int) -> str | None:
        """Why it must be closed now; None while it may stay open.

        The peer's keys count on the own list and on that of its domain; the grants' entries also on
        that of the domain the name is of. Missing revocation data closes it after `STALE_GRACE`,
        unless every permission used says `on_stale: keep`: an emergency stop must not depend on it.
        A revocation, and the end of the trust in a domain, always close it.
        """
        if now >= self.ends:
            return "its grant or its certificate has expired"
        # What ends it when revoked, with the domain whose list says so.
        peer = self.stream.peer
        of_peer = dict.fromkeys((trust_status.anchors.own.domain, peer.domain))
        of_grants = of_peer | dict.fromkeys(grant.domain for grant in self.decision.grants)
        entries = [*product(of_peer, peer.keys), *product(of_grants, self.decision.grant_ids)]
        errors = {(domain, entry): _error_of(domain, entry, trust_status, now) for domain, entry in entries}
        for error in errors.values():  # all of them before staleness, which the first may have too
            if isinstance(error, Revoked | NotAdmitted):
                return str(error)
        try:
            trust_status.check_trust(peer, now)
            _check_label(self.decision, trust_status)
        except NotAdmitted as error:
            return str(error)
        if self.decision.keep_when_stale:
            return None
        for entry, stale in errors.items():
            if stale is not None and now >= trust_status.status_valid_until(*entry) + STALE_GRACE:
                return str(stale)
        return None


def _error_of(
    domain: str, entry: bytes, trust_status: TrustStatus, now: int
) -> Revoked | NotAdmitted | RevocationsStale | None:
    try:
        trust_status.check(domain, entry, now)
    except (Revoked, NotAdmitted, RevocationsStale) as error:
        return error
    return None


def _check_label(decision: Decision, trust_status: TrustStatus) -> None:
    # What a gateway serves is of the own domain's grants, and ends with the label. Whose label it is then,
    # the gateway's own connections to the origin have been cut for.
    served = alias_of_served(decision.name)
    found = split_alias(decision.name if served is None else served)
    if found is None:
        return
    listed = trust_status.anchors.listed(found[0])
    if served is not None and listed is not None:
        return
    domain = None if listed is None else listed.entry.domain
    if any(grant.domain != domain for grant in decision.grants):
        raise NotAdmitted(f"{found[0]} is no longer the domain it was")


Connection: TypeAlias = AuthorizedConnection[Any, Any]


class _Budgets:
    # Every renewal that is judged costs signatures; a domain that is foreign has one budget for all its keys,
    # as it makes as many as it likes.

    def __init__(self) -> None:
        self._lock = Lock()
        self._buckets: dict[bytes | str, TokenBucket] = {}

    def admits(self, peer: Identity, now: int) -> bool:
        source = peer.domain if peer.is_foreign else peer.thumbprint
        with self._lock:
            bucket = self._buckets.get(source)
            if bucket is None:
                if len(self._buckets) >= _PEERS:
                    left = self._buckets.items()
                    self._buckets = {key: each for key, each in left if each.refill(now) < _AT_ONCE}
                bucket = self._buckets[source] = TokenBucket(_A_SECOND, _AT_ONCE)
            if bucket.refill(now) < 1:
                return False
            bucket.tokens -= 1
            return True


class RenewedGrants:
    """Renewed grants on open connections: those of the peer are judged, this node's are presented.

    What a peer presents is judged as in its connection header, by the same function: for the key of the
    connection, the right and the name it has. If that authorizes it, the decision takes the place of the one
    in force between two messages, whether it is longer, narrower or wider; it is checked once more then, as a
    revocation may have arrived while it was judged. If not, the one in force stays, and is not prolonged;
    what was refused is judged again, since the list it needs may be on its way, and once more when the
    connection would end. A decision that cannot be applied to a connection that is open ends it: it is made
    anew under it. Thread-safe; nothing is judged with a lock held.
    """

    def __init__(self, access: HandshakeAccess) -> None:
        self._access = access
        self._budgets = _Budgets()
        self._replacing = Lock()
        self._version = -1
        self._changed_at = 0

    # -- what peers present

    def opened(self, connection: Connection, on_renewed: Callable[[Connection], None]) -> None:
        if connection.rebuild is None:
            return

        def take(renewal: Renewal[Identity]) -> None:
            try:
                self._take(connection, renewal, on_renewed)
            except Exception:  # noqa: BLE001 - fail closed: a check that crashes leaves nothing open
                _log.exception("a renewal of %s cannot be judged", _peer(connection))
                connection.stream.abort("what the peer presents cannot be judged")

        connection.stream.on_renewal(take)

    def _take(
        self, connection: Connection, renewal: Renewal[Identity], on_renewed: Callable[[Connection], None]
    ) -> None:
        match renewal:
            case IdentityRenewed():
                connection.update_end()
                on_renewed(connection)
            case GrantsPresented(data):
                # Kept also where it is refused: the list that it needs may be on its way.
                connection.presented.by_peer = data
                connection.presented.pause = _RETRY
                held = connection.decision
                self._judge_within_budget(connection, clock.now())
                if connection.decision is not held:
                    on_renewed(connection)
            case _:
                why = printable(renewal.reason)
                _log.info("%s presents a certificate that is refused: %s", _peer(connection), why)

    def retry(self, connections: Iterable[Connection], now: int) -> None:
        for connection in connections:
            retry_at = connection.presented.retry_at
            if retry_at is not None and retry_at <= now:
                self._judge_within_budget(connection, now)

    def _judge_within_budget(self, connection: Connection, now: int) -> None:
        if not self._budgets.admits(connection.stream.peer, now) or not self.continues(connection, now):
            presented = connection.presented
            presented.retry_at = now + presented.pause
            presented.pause = min(2 * presented.pause, _LONGEST)

    def continues(self, connection: Connection, now: int) -> bool:
        # Whether what the peer has presented authorizes the connection, which may be about to end.
        held, data, rebuild = connection.decision, connection.presented.by_peer, connection.rebuild
        if not data or rebuild is None:
            return False
        try:
            decision = self._access.authorize(connection.stream.peer, data, held.right, held.name, now)
        except HintedError as error:
            _log.info("%s presents grants that are refused: %s", _peer(connection), printable(error))
            return False
        connection.presented.retry_at = None
        try:
            guard = rebuild(decision)
        except HintedError as error:
            reason = f"what the peer may do now needs a new connection: {printable(error)}"
            _log.info("closed the connection with %s: %s", _peer(connection), reason)
            connection.stream.abort(reason)
            return True
        with self._replacing:
            if connection.decision is held:
                connection.replace(decision, guard)
                return True
        return self.continues(connection, now)  # another thread was faster, maybe with what was before

    # -- what this node presents

    def present(self, connections: Iterable[Connection], version: int, now: int) -> None:
        if version != self._version:
            self._version, self._changed_at = version, now
        for connection in connections:
            presented = connection.presented
            if connection.rebuild is None or presented.version == version:
                continue
            if presented.version < 0 and presented.opened > self._changed_at + _HEADER:
                presented.version = version  # its header had them
            elif now >= presented.next_at:
                self._present(connection, version, now)

    def _present(self, connection: Connection, version: int, now: int) -> None:
        presented, decision = connection.presented, connection.decision
        presented.version = version
        try:
            grants = self._access.present(_OTHERS[decision.right], decision.name, now)
            if grants in (_NOTHING, presented.by_self):
                return
            if connection.stream.present_grants(grants):
                presented.by_self, presented.next_at = grants, now + PACE
        except (HintedError, LimitExceeded) as error:
            _log.info("not presented to %s: %s", _peer(connection), printable(error))


def _peer(connection: Connection) -> str:
    return f"{shown(connection.stream.peer.name)} ({shown(connection.decision.name)})"
