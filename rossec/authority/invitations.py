"""Invitations of an authority: made, listed and ended. Making one needs no key: it is a record.

The code exists only where it is printed. What is recorded is the public half of the key in it, so
neither the record nor a backup lets anybody join. `joining` decides what is asked by it.
"""

import secrets
from hashlib import sha256
from typing import Final, NamedTuple

from ca.enrollment.invitation import SECRET_SIZE, InvitationCode
from ca.names import check_name, check_wildcard, is_reserved
from ca.patterns import check_pattern
from ca.revocation.state import RevocationList
from ca.store.invitations import InvitationRow, InvitationUse
from ca.store.record import Store
from rossec.authority import thing_records
from rossec.authority.home import AuthorityHome
from rossec.authority.joining import source
from rossec.authority.signing import SigningAuthority
from rossec.errors import ConfigurationError

MAX_USES: Final = 10_000


class InvitationStatus(NamedTuple):
    """An invitation with its uses; `ended` says why it was ended, or is None."""

    row: InvitationRow
    uses: list[InvitationUse]
    ended: str | None

    @property
    def short_id(self) -> str:
        """The first 8 hexadecimal digits of its id, for people."""
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
    """Record an invitation for `uses` new names within `pattern`; returns its code, a secret.

    Raises:
        PatternRefused: not a pattern of names.
        NameRefused: with `wildcard`, names that cannot have a tail.
        ConfigurationError: it would allow reserved names only.
        CodeRefused: the address does not fit into a code.
    """
    check_invitation(pattern, wildcard=wildcard)
    code, row = make_invitation(home, pattern, uses, expires, address, now, wildcard=wildcard)
    store = home.store()
    try:
        store.invitations.add(row)
    finally:
        store.close()
    return code


def check_invitation(pattern: str, *, wildcard: bool) -> None:
    """Return if there can be an invitation for names within `pattern`.

    Raises:
        PatternRefused, NameRefused, ConfigurationError: as `invite`.
    """
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
    home: AuthorityHome,
    pattern: str,
    uses: int,
    expires: int,
    address: str,
    now: int,
    *,
    wildcard: bool,
) -> tuple[InvitationCode, InvitationRow]:
    """A new code, and the row that has to be recorded before it is shown.

    Raises:
        CodeRefused: the address does not fit into a code.
    """
    root = sha256(home.anchor().certificate).digest()
    secret = secrets.token_bytes(SECRET_SIZE)
    code = InvitationCode(root, secret, expires, address, pattern, wildcard=wildcard)
    return code, InvitationRow(code.id, code.key, pattern, uses, wildcard, expires, now)


def invitations(store: Store) -> list[InvitationStatus]:
    """Every invitation, oldest first."""
    table = store.invitations
    return [InvitationStatus(row, table.uses(row.id), table.ended(row.id)) for row in table.all()]


def find(store: Store, beginning: str) -> InvitationStatus:
    """The one invitation whose id begins so.

    Raises:
        ConfigurationError: there is none, or more than one.
    """
    given = beginning.lower()
    found = [each for each in invitations(store) if given and each.row.id.hex().startswith(given)]
    if len(found) != 1:
        count = "several invitations begin" if found else "no invitation begins"
        raise ConfigurationError(f"{count} with {beginning!r}", "see: rossec ca invitations")
    return found[0]


def end(store: Store, invitation: InvitationStatus, reason: str, now: int) -> int:
    """End an invitation, and deny what waits because of it; returns their number.

    Also what a person approved while the key was locked, and is not issued yet.
    """
    with store.transaction():
        store.invitations.end(invitation.row.id, reason, now)
        waiting = [row for row in store.requests.open(now) if row.source == source(invitation.row)]
        for row in waiting:
            store.requests.deny(row.digest, now, f"its invitation was ended: {reason}")
    return len(waiting)


def revoke_nodes(
    authority: SigningAuthority, invitation: InvitationStatus, reason: str, now: int
) -> tuple[RevocationList | None, list[str]]:
    """Revoke every key of the names that joined by an invitation; returns the list, and the names.

    A key that a node has renewed since is one of them. Without any there is no new list.
    """
    with authority.store.transaction():
        names = sorted({use.name for use in authority.store.invitations.uses(invitation.row.id)})
        keys = {name: authority.store.unrevoked_keys(name, now) for name in names}
        things = (
            thing_records.ended_with(authority.store, name, now) for name in names if keys[name]
        )
        revoked = frozenset().union(*keys.values(), *things)
        listed = authority.revoke_all(revoked, reason, now) if revoked else None
    return listed, [name for name in names if keys[name]]
