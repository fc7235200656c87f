"""What the console shows of the record: identities, grants, requests, join codes, phones, the log.

Each answer is one look at the record, newest first where it is long: what does not fit into an
answer is left out, and the log of the service says so. Nothing here needs the key.
"""

import contextlib
import logging
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Final, TypeVar

from ca.approvals.approval import Approval
from ca.approvals.statement import Kind
from ca.encoding import Value, encode
from ca.errors import HintedError
from ca.store.approvals import ApprovalState
from ca.store.record import CertificateRow, Store
from grants import document
from rossec.authority import invitations
from rossec.authority.console.messages import MAX_ANSWER
from rossec.authority.console.records import to_value
from rossec.authority.console.sentences import sentence
from rossec.authority.console.views import (
    ApprovalView,
    EventView,
    GrantView,
    IdentityRequestView,
    InvitationView,
    NodeView,
    PhoneView,
)
from rossec.authority.keyservice.work import AuthorityWork

KEPT: Final = 30 * 86400  # seconds for which ended grants are shown
MAX_EVENTS: Final = 500  # of one answer
MAX_APPROVALS: Final = 100
_MAX_NUMBER: Final = (1 << 63) - 1  # of SQLite
_MAX_ROWS: Final = 20_000  # grants that are looked at
ROOM: Final = MAX_ANSWER - 64 * 1024
_log = logging.getLogger("rossec.authority.service")

Deliveries = Callable[[], Mapping[bytes, str]]


class Reading:
    """The operations that read the record.

    Args:
        work: of the authority.
        last_used: when passkeys were last used to log in.
        deliveries: what the master says of each grant; without one, nothing.
    """

    def __init__(
        self,
        work: AuthorityWork,
        last_used: Callable[[bytes], int],
        deliveries: Deliveries = dict,
    ) -> None:
        self._work = work
        self._last_used = last_used
        self._deliveries = deliveries

    def handlers(self) -> Mapping[str, Callable[..., Value]]:
        """By the operation."""
        return {
            "nodes": self.nodes,
            "grants": self.grants,
            "identity-requests": self.identity_requests,
            "invitations": self.invitations,
            "phones": self.phones,
            "approvals": self.approvals,
            "events": self.events,
        }

    def nodes(self) -> Value:
        """The newest identity of each name, and others with another key that are still valid."""
        at = self._work.now()
        with self._store() as store, store.database.read_transaction():
            ended = {row.entry: row for row in store.revocations()}
            rows = store.identities.all()
        found: dict[tuple[str, bytes], CertificateRow] = {}
        newest = {row.name: row for row in rows}
        for row in rows:
            is_valid = at <= row.not_after and row.thumbprint not in ended
            if is_valid or newest[row.name].thumbprint == row.thumbprint:
                found[row.name, row.thumbprint] = row
        views = []
        for row in found.values():
            revoked = ended.get(row.thumbprint)
            views.append(
                NodeView(
                    row.name, row.thumbprint, row.not_before, row.not_after, row.wildcard,
                    revoked.at if revoked else 0, revoked.reason if revoked else "",
                )
            )  # fmt: skip
        return bounded("identities", reversed(views), lambda view: view.name)

    def grants(self) -> Value:
        """The grants in force, and those that ended within `KEPT`; newest first."""
        oldest = self._work.now() - KEPT
        with self._store() as store, store.database.read_transaction():
            ended = {row.entry: row for row in store.revocations()}
            rules, signed = store.policy_grants(), store.signed_at()
            rows = store.grants()
        states, views = self._deliveries(), []
        for row in shared(reversed(rows), lambda row: row.name, _MAX_ROWS):
            grant = document.peek(row.data)
            revoked = ended.get(row.id) or ended.get(grant.holder)
            if min(grant.cap, revoked.at if revoked else grant.cap) < oldest:
                continue
            views.append(
                GrantView(
                    row.id, row.name, row.data, signed[row.id], grant.expires, grant.cap,
                    revoked.at if revoked else 0, revoked.reason if revoked else "",
                    rules.get(row.id, ""), states.get(row.id, ""),
                )
            )  # fmt: skip
        return bounded("grants", views, lambda view: view.node)

    def identity_requests(self) -> Value:
        """The requests for identities that wait for a person, or for the key."""
        at = self._work.now()
        with self._store() as store:
            store.requests.collect(at)
            views = [
                IdentityRequestView(
                    row.digest, row.name, row.thumbprint, row.source, row.arrived, row.expires,
                    str(row.state), row.wildcard,
                    any(each.thumbprint != row.thumbprint
                        for each in store.identities.by_name(row.name)),
                    row.der,
                )
                for row in store.requests.open(at)
            ]  # fmt: skip
        return bounded("requests", reversed(views))

    def invitations(self) -> Value:
        """Every join code, newest first."""
        at = self._work.now()
        with self._store() as store, store.database.read_transaction():
            views = [
                InvitationView(
                    each.row.id, each.row.pattern, each.row.uses,
                    tuple(use.name for use in each.uses), each.row.wildcard, each.row.expires,
                    each.row.at, each.state(at),
                )
                for each in invitations.invitations(store)
            ]  # fmt: skip
        return bounded("join codes", reversed(views))

    def phones(self) -> Value:
        """Every passkey, oldest first."""
        with self._store() as store, store.database.read_transaction():
            known, ended = store.passkeys.all(), store.passkeys.ended()
            used, by = store.approvals.last_used(), store.approvals.approvers(Kind.PASSKEY)
        names = {each.id: each.name for each in known}
        views = []
        for each in known:
            last = max(used.get(each.id, 0), self._last_used(each.id))
            why = ended.get(each.id)
            views.append(
                PhoneView(
                    each.id, each.name, each.at, last, names.get(by.get(each.approval, b""), ""),
                    "" if why is None else why or "removed",
                )
            )  # fmt: skip
        return bounded("phones", views)

    def approvals(self, count: int) -> Value:
        """The newest approvals, newest first."""
        with self._store() as store, store.database.read_transaction():
            found = store.approvals.newest(_count(count, MAX_APPROVALS))
            ends = store.approvals.ends()
            names = {each.id: each.name for each in store.passkeys.all()}
        views = []
        for each in found:
            end = ends.get(each.id)
            views.append(
                ApprovalView(
                    each.id, each.kind, _sentence(each), names.get(each.passkey, ""), each.at,
                    end.state if end else str(ApprovalState.WAITING), end.result if end else "",
                )
            )  # fmt: skip
        return bounded("approvals", views)

    def events(self, before: int, count: int) -> Value:
        """Entries of the log, newest first, before the number `before`; 0: the newest."""
        with self._store() as store:
            last = min(before, _MAX_NUMBER) if before > 0 else None
            found = store.log.newest(_count(count, MAX_EVENTS), last)
        return bounded("entries", [EventView(*each[:5]) for each in found])

    def _store(self) -> contextlib.closing[Store]:
        return contextlib.closing(self._work.home().store())


V = TypeVar("V", bound=tuple[Any, ...])
T = TypeVar("T")


def bounded(what: str, views: Iterable[V], owner: Callable[[V], str] = lambda _: "") -> list[Value]:
    """The views that fit into one answer, in their order: the first ones of every owner."""
    given = list(views)
    room = ROOM
    values: dict[int, Value] = {}
    for place in _in_turns([owner(view) for view in given]):
        value = to_value(given[place])
        room -= len(encode(value))
        if room < 0:
            _log.warning("the console is shown the newest %d %s only", len(values), what)
            break
        values[place] = value
    return [values[place] for place in sorted(values)]


def shared(items: Iterable[T], owner: Callable[[T], str], limit: int) -> list[T]:
    """At most `limit` items, in their order: the first ones of every owner."""
    given = list(items)
    chosen = _in_turns([owner(item) for item in given])[:limit]
    return [given[place] for place in sorted(chosen)]


def _in_turns(owners: Sequence[str]) -> list[int]:
    """The places in turns: the first of each owner, then the second of each, and so on."""
    count = Counter[str]()
    turns: list[tuple[int, int]] = []
    for place, owner in enumerate(owners):
        turns.append((count[owner], place))
        count[owner] += 1
    return [place for _, place in sorted(turns)]


def _count(count: int, limit: int) -> int:
    return max(0, min(count, limit))


def _sentence(approval: Approval) -> str:
    try:
        return sentence(approval.read(), approval.payload)
    except HintedError as error:
        return f"an approval that cannot be read: {error}"
