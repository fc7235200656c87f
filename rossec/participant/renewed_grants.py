"""Renewed grants on open connections: those of the peer are judged, this node's are presented.

What a peer presents is judged as in its connection header, by the same function: for the key of the
connection, the right and the name it has. If that authorizes it, the decision takes the place of
the one in force between two messages, whether it is longer, narrower or wider; it is checked once
more then, as a revocation may have arrived while it was judged. If not, the one in force stays, and
is not prolonged; what was refused is judged again, since the list it needs may be on its way, and
once more when the connection would end. A decision that cannot be applied to a connection that is
open (it was made without a message's definition, say) ends the connection: it is made anew under
it. Thread-safe; nothing is judged with a lock held.
"""

import logging
from collections.abc import Callable, Iterable
from threading import Lock
from typing import Any, Final, Protocol, TypeAlias, cast

from ca.certificates import Identity
from ca.domains.aliases import shown
from ca.encoding import encode
from ca.errors import HintedError
from grants.model import Right
from grants.token_bucket import TokenBucket
from rossec import clock
from rossec.channel.states import GrantsPresented, IdentityRenewed, Renewal
from rossec.errors import LimitExceeded
from rossec.participant.access_interfaces import HandshakeAccess
from rossec.participant.authorized import AuthorizedConnection
from rossec.ros.text import printable

PACE: Final = 3  # seconds between two presentations of this node on one connection
_HEADER: Final = 30  # seconds a connection header may be older than the connection's authorization
_RETRY: Final = 2  # seconds until what was refused is judged again; twice as long each time
_LONGEST: Final = 60
_AT_ONCE: Final = (
    256  # presentations of one key that are judged: one for each connection it may have
)
_A_SECOND: Final = 8.0
_PEERS: Final = 1024  # budgets that are kept; full ones are as good as none
_NOTHING: Final = encode([])

_OTHERS: Final = {
    Right.SUBSCRIBE: Right.PUBLISH, Right.PUBLISH: Right.SUBSCRIBE,
    Right.CALL: Right.PROVIDE, Right.PROVIDE: Right.CALL,
}  # fmt: skip
"""The right of this side on a connection, by the one of the peer."""

Connection: TypeAlias = AuthorizedConnection[Any, Any]
_log = logging.getLogger("rossec.node")


class RenewableStream(Protocol):
    """A stream on which both sides may renew what they presented."""

    def on_renewal(self, callback: Callable[[Renewal[Identity]], None]) -> None:
        """Call back with what the peer renews."""

    def present_grants(self, data: bytes) -> bool:
        """Present grants; false: the peer takes none."""


class _Budgets:
    """How many presentations of each key are judged: each costs signatures to verify."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._buckets: dict[bytes | str, TokenBucket] = {}

    def admits(self, peer: Identity, now: int) -> bool:
        """Whether one more of `peer` is judged at `now`; all keys of a foreign domain are one."""
        source = peer.domain if peer.is_foreign else peer.thumbprint
        with self._lock:
            bucket = self._buckets.get(source)
            if bucket is None:
                self._drop_full(now)
                bucket = self._buckets[source] = TokenBucket(_A_SECOND, _AT_ONCE)
            if bucket.refill(now) < 1:
                return False
            bucket.tokens -= 1
            return True

    def _drop_full(self, now: int) -> None:
        if len(self._buckets) >= _PEERS:
            left = self._buckets.items()
            self._buckets = {key: each for key, each in left if each.refill(now) < _AT_ONCE}


class RenewedGrants:
    """Those of the connections of one identity."""

    def __init__(self, access: HandshakeAccess) -> None:
        self._access = access
        self._budgets = _Budgets()
        self._replacing = Lock()
        self._version = -1
        self._changed_at = 0

    # -- what peers present

    def opened(self, connection: Connection, on_renewed: Callable[[Connection], None]) -> None:
        """A connection was authorized; `on_renewed` is called when its peer has renewed it."""
        if connection.rebuild is None:
            return

        def take(renewal: Renewal[Identity]) -> None:
            try:
                self._take(connection, renewal, on_renewed)
            except Exception:  # noqa: BLE001 - fail closed: a check that crashes leaves nothing open
                _log.exception("a renewal of %s cannot be judged", _peer(connection))
                connection.stream.abort("what the peer presents cannot be judged")

        cast("RenewableStream", connection.stream).on_renewal(take)

    def _take(
        self,
        connection: Connection,
        renewal: Renewal[Identity],
        on_renewed: Callable[[Connection], None],
    ) -> None:
        match renewal:
            case IdentityRenewed():
                connection.update_end()
                on_renewed(connection)
            case GrantsPresented(data):
                connection.presented.by_peer = data
                connection.presented.pause = _RETRY
                held = connection.decision
                self._judge_within_budget(connection, clock.now())
                if connection.decision is not held:
                    on_renewed(connection)
            case _:
                _log.info(
                    "%s presents a certificate that is refused: %s",
                    _peer(connection), printable(renewal.reason),
                )  # fmt: skip

    def retry(self, connections: Iterable[Connection], now: int) -> None:
        """Judge again what was refused, where it is time."""
        for connection in connections:
            retry_at = connection.presented.retry_at
            if retry_at is not None and retry_at <= now:
                self._judge_within_budget(connection, now)

    def continues(self, connection: Connection, now: int) -> bool:
        """Whether what the peer has presented authorizes a connection that would end now."""
        return self._judge(connection, now)

    def _judge_within_budget(self, connection: Connection, now: int) -> None:
        if not self._budgets.admits(connection.stream.peer, now) or not self._judge(
            connection, now
        ):
            presented = connection.presented
            presented.retry_at = now + presented.pause
            presented.pause = min(2 * presented.pause, _LONGEST)

    def _judge(self, connection: Connection, now: int) -> bool:
        """Whether what the peer presented last is in force from now on."""
        held, data, rebuild = connection.decision, connection.presented.by_peer, connection.rebuild
        if not data or rebuild is None:
            return False
        try:
            decision = self._access.authorize(
                connection.stream.peer, data, held.right, held.name, now
            )
        except HintedError as error:
            _log.info(
                "%s presents grants that are refused: %s", _peer(connection), printable(error)
            )
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
        return self._judge(connection, now)  # another thread was faster, maybe with what was before

    # -- what this node presents

    def present(self, connections: Iterable[Connection], version: int, now: int) -> None:
        """Present this node's grants on open connections, where they are others than before.

        Args:
            version: of the rights of this node: another one for every change.
        """
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
            if cast("RenewableStream", connection.stream).present_grants(grants):
                presented.by_self, presented.next_at = grants, now + PACE
        except (HintedError, LimitExceeded) as error:
            _log.info("not presented to %s: %s", _peer(connection), printable(error))


def _peer(connection: Connection) -> str:
    return f"{shown(connection.stream.peer.name)} ({shown(connection.decision.name)})"
