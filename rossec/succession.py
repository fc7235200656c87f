"""Successors, signed and recorded: of identities, of the authority's own node, and intermediates.

A shell on top of an open authority. A node asks with its old key (`ca.renewal`) and is answered
once per request; an operator renews by name, for the key the name has.
"""

import secrets
from collections.abc import Callable
from typing import Final

from ca import keys
from ca.authority import DAY, LIFETIME
from ca.errors import Revoked
from ca.renewal import open_renewal, renew_at
from ca.requests import build_request
from ca.signer import KeySigner
from ca.store import CertificateRow
from rossec.authority import OWN_LIFETIME
from rossec.home import NodeHome
from rossec.unlocked import INTERMEDIATE, OWN_NODE, OpenAuthority, certificate_row

SEASON: Final = 90 * DAY


def renew(
    authority: OpenAuthority,
    data: bytes,
    now: int,
    check: Callable[[bytes, int], None] | None = None,
    lifetime: int = LIFETIME,
) -> bytes:
    """Answer a node's renewal (`ca.renewal.sign_renewal`) with its new bundle (PEM).

    `check(entry, now)` raises for what is revoked; by default the authority's record says it, which
    a host that only holds an intermediate cannot know: it passes `Revocations.check`.

    Raises:
        RenewalRefused: not in order, not due, or the identity was renewed by another key before.
        CertificateRefused, RequestRefused, Revoked: as `ca.renewal.open_renewal`.
    """
    anchor = authority.authority.anchor
    renewal = open_renewal(data, anchor, now, check or _recorded(authority))
    answered = authority.store.identities.answer(renewal.request.digest)
    if answered is not None:
        return authority.again(answered, now, wildcard=renewal.identity.wildcard)
    der = authority.authority.renew(renewal, now=now, serial=_serial(), lifetime=lifetime)
    authority.store.add_certificate(
        certificate_row(authority.verify(der, now)),
        now,
        request=renewal.request.digest,
        renews=renewal.identity.thumbprint,
    )
    return authority.bundle(der)


def renew_by_name(authority: OpenAuthority, name: str, now: int, lifetime: int = LIFETIME) -> bytes:
    """Certify the key that `name` has once more; returns the node's new bundle (PEM).

    Raises:
        StoreError: the name has no valid identity.
    """
    held = authority.store.live_certificate(name, now)
    identity = authority.verify(held.der, now)
    der = authority.authority.certify_again(
        identity, identity.public_key, now=now, serial=_serial(), lifetime=lifetime
    )
    row = certificate_row(authority.verify(der, now))
    authority.store.add_certificate(row, now, renews=held.thumbprint)
    return authority.bundle(der)


def renew_own(authority: OpenAuthority, now: int) -> int:
    """Renew the authority's own node, also one that has expired; returns until when it is good."""
    own = NodeHome(authority.path / "node", OWN_NODE)
    key = KeySigner(keys.load_private(own.path / "node.key"))
    request = build_request(key, authority.domain, OWN_NODE)
    return own.install(authority.issue(request, now, OWN_LIFETIME), now).not_after


def own_is_due(authority: OpenAuthority, now: int) -> bool:
    """Whether two thirds of the own node's life are over; an intermediate's host has none."""
    certificates = authority.store.identities.of(OWN_NODE)
    return bool(certificates) and now >= _renew_at(certificates[-1])


def sign_intermediate(
    authority: OpenAuthority, csr: bytes, now: int, *, may_enroll: bool, lifetime: int = SEASON
) -> tuple[str, bytes]:
    """Sign and record an intermediate; returns the name it is revoked by, and its bundle (PEM).

    Raises:
        RequestRefused, IssueRefused: as `ca.authority.Authority.issue_intermediate`.
    """
    root = authority.authority
    der = root.issue_intermediate(
        csr, now=now, serial=_serial(), may_enroll=may_enroll, lifetime=lifetime
    )
    made = root.anchor.read_intermediate(der)
    name = f"{INTERMEDIATE}{made.thumbprint.hex()[:16]}"
    row = CertificateRow(made.serial, name, made.thumbprint, der, made.not_before, made.not_after)
    authority.store.add_certificate(row, now, renews=made.thumbprint)
    return name, authority.bundle(der)


def _renew_at(row: CertificateRow) -> int:
    return renew_at(row.not_before, row.not_after)


def _recorded(authority: OpenAuthority) -> Callable[[bytes, int], None]:
    revoked = authority.store.revoked_entries()

    def check(entry: bytes, now: int) -> None:  # noqa: ARG001  (the record is always of now)
        if entry in revoked:
            raise Revoked(f"{entry.hex()} is revoked", "enroll the node with a new key")

    return check


def _serial() -> int:
    return secrets.randbits(127) + 1
