"""Nodes that join by an invitation: what the process that has the authority's key decides.

The proof is verified first, over hashes: a stranger's request is not parsed. Then one transaction
decides by the record and changes it: a use is taken, the request approved and its identity recorded
together, or nothing is. The same request gets the same answer. A name that was certified for
another key before is not new: it waits for a person, like every request of `rossec ca requests`; so
does one that shares names with such a one through a wildcard tail, and at an intermediate every
name that it has not certified itself, as the root's record is elsewhere.
"""

from typing import Final

from ca.certificates import from_pem
from ca.enrollment.join_claim import JoinClaim
from ca.enrollment.join_messages import (
    Issued,
    JoinAnswer,
    Refused,
    RefuseReason,
    Waiting,
    WaitReason,
)
from ca.enrollment.join_request import JoinRequest
from ca.errors import (
    CAError,
    InvitationRefused,
    JoinRefused,
    NameCovered,
    NameRefused,
    RecordUnusable,
    RequestRefused,
    StoreError,
    TooManyRequests,
)
from ca.names import covers as names_cover
from ca.names import is_reserved
from ca.patterns import covers
from ca.requests import IdentityRequest, check_request
from ca.store.invitations import InvitationRow, InvitationUse
from ca.store.lifecycle import RequestRow, RequestState
from ca.store.record import Store
from rossec.authority.signing import SigningAuthority

MAX_WAITING: Final = 16  # requests of one invitation that wait for a person
_REASONS: Final[tuple[tuple[type[CAError], RefuseReason], ...]] = (
    (InvitationRefused, RefuseReason.ENDED),
    (RequestRefused, RefuseReason.REQUEST),
    (NameRefused, RefuseReason.NAME),
    (NameCovered, RefuseReason.NAME),
    (TooManyRequests, RefuseReason.BUSY),
)
_OTHER: Final = RefuseReason.DENIED  # a revoked key, an identity that is not valid any more


def join(authority: SigningAuthority, request: JoinRequest, now: int) -> JoinAnswer:
    """Decide a request to join; what is issued is recorded, with its use, before this returns.

    Raises:
        RecordUnusable: the record cannot be used now; nothing was changed.
        IssueRefused: this authority cannot issue now.
    """
    invitation = _proved(authority.store, request)
    if invitation is None:
        return Refused(RefuseReason.REFUSED)
    try:
        asked = _asked(authority, invitation, request)
        with authority.store.transaction():
            return _decide(authority, invitation, asked, request.csr, now)
    except RecordUnusable:
        raise
    except (StoreError, InvitationRefused, RequestRefused, NameRefused) as error:
        return Refused(_reason(error))


def join_locked(store: Store, request: JoinRequest, now: int) -> JoinAnswer:
    """The answer while the authority is locked: only the holder of an open invitation is told so.

    Raises:
        RecordUnusable: the record cannot be used now.
    """
    invitation = _proved(store, request)
    if invitation is None:
        return Refused(RefuseReason.REFUSED)
    used = any(use.request == request.digest for use in store.invitations.uses(invitation.id))
    try:
        if not used:  # a request that was answered gets its answer again, however late
            store.invitations.check_open(invitation.id, now)
    except InvitationRefused:
        return Refused(RefuseReason.ENDED)
    return Waiting(WaitReason.LOCKED)


def allowed_pattern(store: Store, asked: JoinClaim | JoinRequest, now: int) -> str | Refused:
    """The pattern of the invitation whose secret `asked` proves, or why it is not answered.

    What a node says of itself may be looked at only then. An invitation that somebody has joined by
    is answered also after its end, as that may be the node which asks: it may have lost its answer.

    Raises:
        RecordUnusable: the record cannot be used now.
    """
    invitation = _proved(store, asked)
    if invitation is None:
        return Refused(RefuseReason.REFUSED)
    try:
        if not store.invitations.uses(invitation.id):
            store.invitations.check_open(invitation.id, now)
    except InvitationRefused:
        return Refused(RefuseReason.ENDED)
    return invitation.pattern


def is_proved(store: Store, asked: JoinClaim | JoinRequest) -> bool:
    """Whether it was made with the secret of an invitation: what is cheap to know of a stranger.

    Raises:
        RecordUnusable: the record cannot be used now.
    """
    return _proved(store, asked) is not None


def source(invitation: InvitationRow) -> str:
    """Where the requests of an invitation come from, for the approver."""
    return f"invitation {invitation.id.hex()[:8]}"


def _proved(store: Store, request: JoinClaim | JoinRequest) -> InvitationRow | None:
    """The invitation whose secret the request proves; None if it does not."""
    try:
        found = store.invitations.get(request.invitation)
        request.verify(found.key)
    except (InvitationRefused, JoinRefused):
        return None
    return found


def _asked(
    authority: SigningAuthority, invitation: InvitationRow, request: JoinRequest
) -> IdentityRequest:
    """What is asked for, if the invitation allows it.

    Raises:
        RequestRefused: the CSR is invalid, or not the one that the proof is about.
        NameRefused: another name.
    """
    found = check_request(request.csr, authority.domain, wildcard=invitation.wildcard)
    if found.name != request.name or found.wildcard != invitation.wildcard:
        raise RequestRefused("the request is not the one that was proved")
    if is_reserved(found.name) or not covers(invitation.pattern, found.name):
        raise NameRefused(f"the invitation is not for {found.name}")
    return found


def _decide(
    authority: SigningAuthority,
    invitation: InvitationRow,
    asked: IdentityRequest,
    csr: bytes,
    now: int,
) -> JoinAnswer:
    """Inside the transaction: repeat an answer, wait for a person, or issue."""
    store, origin = authority.store, source(invitation)
    row = store.requests.find(asked.digest)
    if store.identities.issued_for(asked.digest) is None:
        if row is not None and row.state is not RequestState.APPROVED:
            return _repeated(row)
        if row is None and _needs_person(authority, asked, now):
            store.invitations.check_open(invitation.id, now)
            if sum(each.source == origin for each in store.requests.open(now)) >= MAX_WAITING:
                return Refused(RefuseReason.BUSY)
            return _repeated(store.requests.add(asked, csr, origin, now))
        if row is None:
            use = InvitationUse(invitation.id, asked.digest, asked.name, asked.thumbprint, now)
            store.invitations.take(use)
    bundle = authority.issue(csr, now, wildcard=asked.wildcard, source=origin)
    *chain, _ = from_pem(bundle)
    return Issued(tuple(chain))


def _repeated(row: RequestRow) -> JoinAnswer:
    """The answer to a recorded request without an identity."""
    if row.state is RequestState.PENDING:
        return Waiting(WaitReason.PERSON)
    return Refused(RefuseReason.DENIED)


def _needs_person(authority: SigningAuthority, asked: IdentityRequest, now: int) -> bool:
    """Whether another key had one of the names, or may have had it, or asks for it.

    Raises:
        NameCovered: another key has one of the names now, through a wildcard tail.
    """
    store, name, key = authority.store, asked.name, asked.thumbprint

    def shared(other: str) -> bool:
        return names_cover(name, other, wildcard=asked.wildcard)

    store.identities.check_names(name, key, now, shared)
    if not authority.authority.is_root:  # the root's record is elsewhere
        known = store.identities.by_name(name)
        if all(row.thumbprint != key for row in known):
            return True
    waiting = (
        shared(row.name) or names_cover(row.name, name, wildcard=row.wildcard)
        for row in store.requests.open(now)
        if row.thumbprint != key
    )
    return any(waiting) or bool(store.identities.ever_shared(name, key, shared))


def _reason(error: CAError) -> RefuseReason:
    """What the holder of an invitation is told."""
    return next((reason for kind, reason in _REASONS if isinstance(error, kind)), _OTHER)
