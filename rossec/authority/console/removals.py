"""Taking away: what a person at the console does without a passkey. Denying is never harder.

Everything is recorded at once, also while the key is locked: a revocation is then on the list that
is signed at unlock. What was approved and still waits for the key comes to nothing as soon as what
it is about is denied or ended. Only `/master` is not revoked here: nothing works without one, so a
stolen session must not end it.
"""

import contextlib
from collections.abc import Callable, Mapping
from typing import Final

from ca.approvals.statement import Kind
from ca.encoding import Value
from ca.errors import RequestClosed, StoreError
from ca.names import check_name, is_master_name
from ca.store.approvals import ApprovalState
from ca.store.record import Store
from ca.store.rows import INTERMEDIATE
from rossec.authority import invitations, thing_records
from rossec.authority.approvals import DENIED
from rossec.authority.console.questions import is_about, question_id
from rossec.authority.invitations import InvitationStatus
from rossec.authority.keyservice.work import AuthorityWork
from rossec.authority.requests import GrantRequestStore
from rossec.authority.signing import OWN_NODE
from rossec.errors import AuthorityLocked, ConfigurationError, KeyServiceRefused

PURPOSE: Final = "a revocation at the console"
MAX_REASON: Final = 256  # characters
UNSIGNED: Final = (0, 0)  # the number of a list that is signed when the key is unlocked

Find = Callable[[Store, int], frozenset[bytes]]


class Removals:
    """The operations that take away.

    Args:
        work: of the authority.
        wake: begins a round of the service, which tells the master.
    """

    def __init__(self, work: AuthorityWork, wake: Callable[[], None]) -> None:
        self._work = work
        self._wake = wake

    def handlers(self) -> Mapping[str, Callable[..., Value]]:
        """By the operation."""
        return {
            "deny-request": self.deny_request,
            "deny-question": self.deny_question,
            "revoke-grant": self.revoke_grant,
            "revoke-node": self.revoke_node,
            "end-invitation": self.end_invitation,
            "remove-phone": self.remove_phone,
        }

    def deny_request(self, digest: bytes, reason: str) -> Value:
        """Deny a request for an identity, also one that was approved and is not issued yet.

        Raises:
            RequestClosed: it was issued, or denied before; or there is none.
        """
        why, at = checked_reason(reason), self._work.now()
        with contextlib.closing(self._work.home().store()) as store, store.transaction():
            if store.requests.find(digest) is None:
                raise RequestClosed("there is no such request", "it may have expired")
            store.requests.deny(digest, at, why)
            _end_about(store, Kind.ENROLL, digest, why, at)
        return None

    def deny_question(self, request: bytes, reason: str) -> Value:
        """Deny a right, or a whole request, also if it was approved and is not signed yet.

        Raises:
            StoreError: there is no such question, or it was answered.
        """
        why, at = checked_reason(reason), self._work.now()
        with contextlib.closing(self._work.home().store()) as store, store.transaction():
            table = GrantRequestStore(store.database)
            found = [each for each in table.unanswered() if is_about(each, request)]
            for each in found:
                table.answer(each, DENIED, why or "a person", at)
            parts = {request, *map(question_id, table.find(request))}
            ended = [_end_about(store, Kind.GRANT, part, why, at) for part in sorted(parts)]
            if not found and not any(ended):
                raise StoreError("this question was answered", "look at what happened to it")
        return None

    def revoke_grant(self, grant: bytes, reason: str) -> Value:
        """Revoke a grant; returns the number of the list, `UNSIGNED` while the key is locked.

        Raises:
            StoreError: there is no such grant.
        """

        def find(store: Store, _: int) -> frozenset[bytes]:
            if all(row.id != grant for row in store.grants()):
                raise StoreError("there is no such grant", "look again: the record was changed")
            return frozenset((grant,))

        return self._revoke(find, reason)

    def revoke_node(self, name: str, reason: str) -> Value:
        """Revoke every key of a node, or an intermediate; returns as `revoke_grant`.

        Raises:
            KeyServiceRefused: it is the authority's own node, or a master.
            ConfigurationError: it has no valid identity.
        """
        if name == OWN_NODE:
            raise KeyServiceRefused(
                f"{name} is the authority's own node, which tells the master what is revoked",
                "if the authority was stolen, make a new one",
            )
        if is_master_name(name):
            raise KeyServiceRefused(
                f"without {name} its nodes find nothing: a phone has to approve that",
                "approve it there",
            )
        return self._revoke(keys_of(name), reason)

    def end_invitation(self, invitation: bytes, reason: str) -> Value:
        """End a join code; what waits because of it is denied.

        Raises:
            InvitationRefused: there is none.
        """
        why, at = checked_reason(reason), self._work.now()
        with contextlib.closing(self._work.home().store()) as store, store.transaction():
            table = store.invitations
            status = InvitationStatus(
                table.get(invitation), table.uses(invitation), table.ended(invitation)
            )
            before = {row.digest for row in store.requests.open(at)}
            invitations.end(store, status, why, at)
            for digest in sorted(before - {row.digest for row in store.requests.open(at)}):
                _end_about(store, Kind.ENROLL, digest, f"its join code was ended: {why}", at)
        return None

    def remove_phone(self, passkey: bytes, reason: str) -> Value:
        """End a passkey, and what it approved and is not carried out yet.

        Raises:
            PasskeyUnknown: there is none, or it has ended.
        """
        with contextlib.closing(self._work.home().store()) as store:
            store.remove_passkey(passkey, checked_reason(reason), self._work.now())
        return None

    def _revoke(self, find: Find, reason: str) -> Value:
        number = revoke(self._work, find, checked_reason(reason), PURPOSE)
        self._wake()
        return [*number]


def checked_reason(text: str) -> str:
    """Return a reason that fits into the record.

    Raises:
        KeyServiceRefused: it is too long.
    """
    if len(text) > MAX_REASON:
        raise KeyServiceRefused(
            f"a reason of {len(text)} characters where {MAX_REASON} are allowed", "write less"
        )
    return text.strip()


def keys_of(name: str) -> Find:
    """Finds the keys of `name`, and the things that end with them.

    It raises `ConfigurationError` if there is no key to revoke.
    """

    def find(store: Store, at: int) -> frozenset[bytes]:
        sought = name if name.startswith(INTERMEDIATE) else check_name(name)
        found = store.unrevoked_keys(sought, at)
        if not found:
            raise ConfigurationError(
                f"{name} has no valid identity to revoke", "it may have been revoked already"
            )
        return found | thing_records.ended_with(store, sought, at)

    return find


def revoke(work: AuthorityWork, find: Find, reason: str, purpose: str) -> tuple[int, int]:
    """Record a revocation of what `find` finds, with its list unless the key is locked.

    Returns the number of the list, or `UNSIGNED`.

    Raises:
        ConfigurationError: this is an intermediate.
    """
    at = work.now()
    with work.service(purpose) as service:
        if service.home.is_intermediate:
            raise ConfigurationError("an intermediate cannot revoke", "do it at the root")
        try:
            authority = service.unlock()
            with authority.store.transaction():
                entries = find(authority.store, at)
                listed = authority.revoke_all(entries, reason, at)
        except AuthorityLocked:
            pass
        else:
            return listed.number
        with contextlib.closing(service.home.store()) as store, store.transaction():
            for entry in sorted(find(store, at)):
                store.revoke(entry, reason, at)
    return UNSIGNED


def _end_about(store: Store, kind: Kind, subject: bytes, reason: str, at: int) -> bool:
    """End the approvals of `subject` that wait; whether there was one. Inside a transaction."""
    waiting = [
        approval
        for approval in store.approvals.about(kind, subject)
        if store.approvals.state(approval.id) is ApprovalState.WAITING
    ]
    for approval in waiting:
        result = f"denied: {reason}" if reason else "denied"
        store.approvals.end(approval.id, ApprovalState.FAILED, result, at)
    return bool(waiting)
