"""Invitations, and the nodes that join by one: what the process that has the authority's key decides.

The code exists only where it is printed. What is recorded is the public half of the key in it, so
neither the record nor a backup lets anybody join, and making one needs no key of the authority.
"""

import secrets
from contextlib import closing
from hashlib import sha256
from typing import Final, NamedTuple

from ca import certificates, errors
from ca.enrollment.invitation import SECRET_SIZE, InvitationCode, JoinClaim, JoinRequest
from ca.enrollment.join import Issued, JoinAnswer, RefusedMessage, RefuseReason, WaitingMessage, WaitReason
from ca.names import check_name, check_pattern, check_wildcard, is_reserved, pattern_covers
from ca.names import covers as names_cover
from ca.revocation.lists import RevocationList
from ca.store.identities import InvitationRow, InvitationUse
from ca.store.record import Store
from ca.store.values import RequestRow, RequestState
from ca.svid import IdentityRequest, check_request
from rossec.authority import signing
from rossec.authority.home import AuthorityHome
from rossec.authority.signing import SigningAuthority
from rossec.errors import ConfigurationError

MAX_WAITING: Final = 16  # requests of one invitation that wait for a person
_REASONS: Final[tuple[tuple[type[errors.CAError], RefuseReason], ...]] = (
    (errors.JoinRefused, RefuseReason.ENDED),
    (errors.RequestRefused, RefuseReason.REQUEST),
    (errors.NameRefused, RefuseReason.NAME),
    (errors.NameCovered, RefuseReason.NAME),
    (errors.TooManyRequests, RefuseReason.BUSY),
)


def join(authority: SigningAuthority, request: JoinRequest, now: int) -> JoinAnswer:
    # 1. The proof, over hashes: until it is verified, a stranger's request is not parsed.
    invitation = _proved(authority.store, request)
    if invitation is None:
        return RefusedMessage(RefuseReason.REFUSED)
    try:
        # 2. What is asked is what was proved, and within the invitation.
        found = check_request(request.csr, authority.domain, wildcard=invitation.wildcard)
        if found.name != request.name or found.wildcard != invitation.wildcard:
            raise errors.RequestRefused("the request is not the one that was proved")
        if is_reserved(found.name) or not pattern_covers(invitation.pattern, found.name):
            raise errors.NameRefused(f"the invitation is not for {found.name}")
        # 3. One transaction decides by the record and changes it, or nothing is done.
        with authority.store.transaction():
            return _decide(authority, invitation, found, request.csr, now)
    except errors.RecordUnusable:
        raise
    except (errors.StoreError, errors.JoinRefused, errors.RequestRefused, errors.NameRefused) as error:
        # What has no reason of its own: a revoked key, an identity that is not valid any more.
        reasons = (reason for kind, reason in _REASONS if isinstance(error, kind))
        return RefusedMessage(next(reasons, RefuseReason.DENIED))


def join_locked(store: Store, request: JoinRequest, now: int) -> JoinAnswer:
    invitation = _proved(store, request)
    if invitation is None:
        return RefusedMessage(RefuseReason.REFUSED)
    used = any(use.request == request.digest for use in store.invitations.uses(invitation.id))
    try:
        if not used:  # a request that was answered gets its answer again, however late
            store.invitations.check_open(invitation.id, now)
    except errors.JoinRefused:
        return RefusedMessage(RefuseReason.ENDED)
    return WaitingMessage(WaitReason.LOCKED)


def allowed_pattern(store: Store, asked: JoinClaim | JoinRequest, now: int) -> str | RefusedMessage:
    """The pattern of the invitation whose secret `asked` proves, or why it is not answered."""
    # What a node says of itself may be looked at only then. An invitation that somebody has joined by is
    # answered also after its end, as that may be the node which asks: it may have lost its answer.
    invitation = _proved(store, asked)
    if invitation is None:
        return RefusedMessage(RefuseReason.REFUSED)
    try:
        if not store.invitations.uses(invitation.id):
            store.invitations.check_open(invitation.id, now)
    except errors.JoinRefused:
        return RefusedMessage(RefuseReason.ENDED)
    return invitation.pattern


def is_proved(store: Store, asked: JoinClaim | JoinRequest) -> bool:
    """Whether it was made with the secret of an invitation: what is cheap to know of a stranger."""
    return _proved(store, asked) is not None


def source(invitation: InvitationRow) -> str:
    return f"invitation {invitation.id.hex()[:8]}"


def _proved(store: Store, request: JoinClaim | JoinRequest) -> InvitationRow | None:
    # The invitation whose secret the request proves; None if it does not.
    try:
        found = store.invitations.get(request.invitation)
        request.verify(found.key)
    except errors.JoinRefused:
        return None
    return found


def _decide(
    authority: SigningAuthority, invitation: InvitationRow, asked: IdentityRequest, csr: bytes, now: int
) -> JoinAnswer:
    store, origin = authority.store, source(invitation)
    row = store.requests.find(asked.digest)
    if store.identities.issued_for(asked.digest) is None:
        if row is not None and row.state is not RequestState.APPROVED:
            return _repeated(row)
        if row is None and _needs_person(authority, asked, now):
            store.invitations.check_open(invitation.id, now)
            # The record has room for few requests that wait, and one code must not fill it.
            if sum(each.source == origin for each in store.requests.open(now)) >= MAX_WAITING:
                return RefusedMessage(RefuseReason.BUSY)
            return _repeated(store.requests.add(asked, csr, origin, now))
        if row is None:
            use = InvitationUse(invitation.id, asked.digest, asked.name, asked.thumbprint, now)
            store.invitations.take(use)
    bundle = authority.issue(csr, now, wildcard=asked.wildcard, source=origin)
    *chain, _ = certificates.from_pem(bundle)
    return Issued(tuple(chain))


def _repeated(row: RequestRow) -> JoinAnswer:
    if row.state is RequestState.PENDING:
        return WaitingMessage(WaitReason.PERSON)
    return RefusedMessage(RefuseReason.DENIED)


# A name that was certified for another key before is not new, nor is one that shares names with such a one
# through a wildcard.
def _needs_person(authority: SigningAuthority, asked: IdentityRequest, now: int) -> bool:
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


MAX_USES: Final = 10_000


class InvitationStatus(NamedTuple):
    """An invitation with its uses; `ended` says why it was ended, or is None."""

    row: InvitationRow
    uses: list[InvitationUse]
    ended: str | None

    @property
    def short_id(self) -> str:
        return self.row.id.hex()[:8]

    def state(self, now: int) -> str:
        """Whether it can be used: `open`, or why not."""
        if self.ended is not None:
            return f"ended: {self.ended}"
        if now > self.row.expires:
            return "expired"
        return "open" if len(self.uses) < self.row.uses else "used up"


def invite(
    home: AuthorityHome,
    pattern: str,
    uses: int,
    expires: int,
    address: str,
    now: int,
    *,
    wildcard: bool = False,
) -> InvitationCode:
    check_invitation(pattern, wildcard=wildcard)
    code, row = make_invitation(home, pattern, uses, expires, address, now, wildcard=wildcard)
    with closing(home.store()) as store:
        store.invitations.add(row)
    return code


def check_invitation(pattern: str, *, wildcard: bool) -> None:
    check_pattern(pattern)
    if wildcard and "*" not in pattern:
        check_wildcard(check_name(pattern))
    one = pattern if pattern.endswith("**") else pattern.replace("*", "name")
    if is_reserved(one):  # `/relay/*` covers nothing else
        raise ConfigurationError(
            f"{pattern} is reserved: no invitation is for it",
            f"enroll it in person: rossec node enroll {one}",
        )


def make_invitation(
    home: AuthorityHome, pattern: str, uses: int, expires: int, address: str, now: int, *, wildcard: bool
) -> tuple[InvitationCode, InvitationRow]:
    # The root is in the code: the node knows the authority before it trusts anything.
    root = sha256(home.anchor().certificate).digest()
    secret = secrets.token_bytes(SECRET_SIZE)
    code = InvitationCode(root, secret, expires, address, pattern, wildcard=wildcard)
    return code, InvitationRow(code.id, code.key, pattern, uses, wildcard, expires, now)


def invitations(store: Store) -> list[InvitationStatus]:
    table = store.invitations
    return [InvitationStatus(row, table.uses(row.id), table.ended(row.id)) for row in table.all()]


def find(store: Store, beginning: str) -> InvitationStatus:
    given = beginning.lower()
    found = [each for each in invitations(store) if given and each.row.id.hex().startswith(given)]
    if len(found) != 1:
        count = "several invitations begin" if found else "no invitation begins"
        raise ConfigurationError(f"{count} with {beginning!r}", "see: rossec ca invitations")
    return found[0]


def end(store: Store, invitation: InvitationStatus, reason: str, now: int) -> int:
    """End an invitation, and deny what waits because of it; returns their number."""
    # Also what a person approved while the key was locked, and is not issued yet.
    with store.transaction():
        store.invitations.end(invitation.row.id, reason, now)
        waiting = [row for row in store.requests.open(now) if row.source == source(invitation.row)]
        for row in waiting:
            store.requests.deny(row.digest, now, f"its invitation was ended: {reason}")
    return len(waiting)


def revoke_nodes(
    authority: SigningAuthority, invitation: InvitationStatus, reason: str, now: int
) -> tuple[RevocationList | None, list[str]]:
    """Revoke every key of the names that joined by an invitation; returns the list, and the names."""
    # A key that a node has renewed since is one of them. Without any there is no new list.
    with authority.store.transaction():
        names = sorted({use.name for use in authority.store.invitations.uses(invitation.row.id)})
        keys = {name: authority.store.unrevoked_keys(name, now) for name in names}
        things = (signing.ended_with(authority.store, name, now) for name in names if keys[name])
        revoked = frozenset().union(*keys.values(), *things)
        listed = authority.revoke_all(revoked, reason, now) if revoked else None
    return listed, [name for name in names if keys[name]]
