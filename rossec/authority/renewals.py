"""Successors, signed and recorded: of identities, of the authority's own node, and intermediates.

A node signs the request with its old key (`ca.renewal`) and gets one answer per request, and no
further certificate while the newest one is not due; an operator renews by name, for the current key
of the name. The old identity is looked up in the transaction that records the successor: a key that
is revoked meanwhile gets none.
"""

import secrets
from collections.abc import Callable, Collection
from typing import Final

from ca.authority import DAY, LIFETIME, MAX_LIFETIME
from ca.certificates import Identity, from_pem
from ca.errors import RenewalRefused, Revoked, StoreError
from ca.keys import key_files
from ca.keys.signer import KeySigner
from ca.renewal import Renewal, open_renewal, renew_at
from ca.requests import build_request
from ca.store.record import CertificateRow, Store
from ca.store.rows import INTERMEDIATE
from rossec.authority import thing_records
from rossec.authority.home import OWN_LIFETIME
from rossec.authority.signing import OWN_NODE, SigningAuthority, certificate_row
from rossec.errors import ConfigurationError
from rossec.home import NodeHome

INTERMEDIATE_LIFETIME: Final = 90 * DAY


def renew(
    authority: SigningAuthority,
    data: bytes,
    now: int,
    check: Callable[[bytes, int], None] | None = None,
    lifetime: int = LIFETIME,
) -> bytes:
    """Answer a node's renewal (`ca.renewal.sign_renewal`) with its new bundle (PEM).

    `check(entry, now)` raises for revoked entries; the default uses the authority's record. The
    host of an intermediate has no such record and passes `Revocations.check`.

    Raises:
        RenewalRefused: invalid, not due, or the identity was renewed by another key before.
        CertificateRefused, RequestRefused, Revoked: as `ca.renewal.open_renewal`.
    """
    with authority.store.transaction():
        return _renew(authority, data, now, check or _check_in_record(authority), lifetime)


def renew_recorded(authority: SigningAuthority, data: bytes, now: int) -> bytes:
    """As `renew`, at the authority itself: only what its record knows, for as long as before.

    Raises:
        RenewalRefused: besides, the identity is not in the record, or not the newest of its name.
    """
    with authority.store.transaction():
        check = _check_in_record(authority)
        renewal = open_renewal(data, authority.authority.anchor, now, check)
        _check_recorded(authority.store, renewal.identity)
        return _renew(authority, data, now, check, MAX_LIFETIME)


def _check_recorded(store: Store, identity: Identity) -> None:
    rows = store.identities.by_name(identity.name)
    if not rows:
        raise RenewalRefused(
            f"{identity.name} is not in the authority's record",
            "was it enrolled by an intermediate? where the authority is: rossec ca import NODE.pem",
        )
    newest = rows[-1]
    if (newest.thumbprint, newest.wildcard) != (identity.thumbprint, identity.wildcard):
        raise RenewalRefused(
            f"{identity.name} has a newer identity, with another key or for other names",
            f"see, where the authority is: rossec ca show {identity.name}",
        )


def _renew(
    authority: SigningAuthority,
    data: bytes,
    now: int,
    check: Callable[[bytes, int], None],
    lifetime: int,
) -> bytes:
    renewal = open_renewal(data, authority.authority.anchor, now, check)
    answered = authority.store.identities.issued_for(renewal.request.digest)
    if answered is not None:
        return authority.issued_bundle(answered, now, wildcard=renewal.identity.wildcard)
    held = _already_renewed(authority, renewal, now)
    if held is not None:
        return authority.bundle(held.der)
    der = authority.authority.renew(renewal, now=now, serial=_serial(), lifetime=lifetime)
    authority.store.add_certificate(
        certificate_row(authority.verify(der, now)),
        now,
        request=renewal.request.digest,
        renews=renewal.identity.thumbprint,
    )
    authority.refresh_list(now)  # the key may be that of a master
    return authority.bundle(der)


def _already_renewed(
    authority: SigningAuthority, renewal: Renewal, now: int
) -> CertificateRow | None:
    """A newer identity for the same key that is not due itself: the answer to other requests.

    Otherwise a node could have any number signed and recorded, as long as its old one is valid.
    """
    identities, wanted = authority.store.identities, renewal.request.thumbprint
    for row in reversed(identities.valid(renewal.identity.name, now)):
        is_newer = row.thumbprint == wanted and row.not_after > renewal.identity.not_after
        is_due = now >= renew_at(row.not_before, row.not_after)
        is_own = identities.issuer(row) is None
        if is_newer and not is_due and is_own and row.wildcard is renewal.identity.wildcard:
            return row
    return None


def renew_by_name(
    authority: SigningAuthority,
    name: str,
    now: int,
    lifetime: int = LIFETIME,
    *,
    expired: bool = False,
) -> bytes:
    """Certify the current key of `name` again; returns the node's new bundle (PEM).

    A node enrolled by an intermediate is then certified by this authority, for the same key.
    With `expired`, the newest identity may have ended: its key, and so its grants, are kept.

    Raises:
        StoreError: the name has no valid identity, its key or its intermediate's is revoked.
        NameCovered: another identity covers the name by now.
    """
    authority.refresh_list(now)
    with authority.store.transaction():
        held = authority.store.renewable_certificate(name, now, expired=expired)
        identity = _identity(authority, held, min(now, held.not_after))
        der = authority.authority.reissue(
            identity, identity.public_key, now=now, serial=_serial(), lifetime=lifetime
        )
        row = certificate_row(authority.verify(der, now))
        authority.store.add_certificate(row, now, renews=held.thumbprint)
    return authority.bundle(der)


def _identity(authority: SigningAuthority, row: CertificateRow, now: int) -> Identity:
    """The identity of a row, verified with the intermediate that signed it, if any."""
    signer = authority.store.identities.issuer(row)
    if signer is None:
        return authority.verify(row.der, now)
    return authority.authority.anchor.verify([row.der, signer.der], now)


def renew_own_node(authority: SigningAuthority, now: int) -> int:
    """Renew the authority's own node, even if expired; returns its `not_after`."""
    own = NodeHome(authority.path / "node", OWN_NODE)
    key = KeySigner(key_files.load_private(own.path / "node.key"))
    request = build_request(key, authority.domain, OWN_NODE)
    return own.install(authority.issue(request, now, OWN_LIFETIME), now).not_after


def own_node_is_due(authority: SigningAuthority, now: int) -> bool:
    """Whether the authority's own node is due for renewal; an intermediate has none."""
    rows = authority.store.identities.by_name(OWN_NODE)
    return bool(rows) and now >= renew_at(rows[-1].not_before, rows[-1].not_after)


def sign_intermediate(
    authority: SigningAuthority,
    csr: bytes,
    now: int,
    *,
    may_enroll: bool,
    lifetime: int = INTERMEDIATE_LIFETIME,
) -> tuple[str, bytes]:
    """Sign and record an intermediate; returns its name for revocation, and its bundle (PEM).

    Raises:
        RequestRefused, IssueRefused: as `ca.authority.Authority.issue_intermediate`.
    """
    authority.refresh_list(now)
    root = authority.authority
    der = root.issue_intermediate(
        csr, now=now, serial=_serial(), may_enroll=may_enroll, lifetime=lifetime
    )
    made = root.anchor.read_intermediate(der)
    name = f"{INTERMEDIATE}{made.thumbprint.hex()[:16]}"
    row = CertificateRow(made.serial, name, made.thumbprint, der, made.not_before, made.not_after)
    authority.store.add_certificate(row, now, renews=made.thumbprint)
    return name, authority.bundle(der)


def import_identity(
    authority: SigningAuthority, bundle: bytes, now: int, replaced: Collection[str] = ()
) -> tuple[Identity, bool]:
    """Record an identity signed by an intermediate of this root; the boolean says if it is new.

    `replaced` are names whose current key may be replaced; that key is revoked.

    Raises:
        CertificateRefused: not a valid identity of this root.
        StoreError: its key, or the intermediate's, is revoked or unknown here.
        KeyChanged, NameCovered: the name belongs to another key.
        ConfigurationError: this is not a root, or the name is the authority's own.
    """
    identity = authority.authority.anchor.verify(from_pem(bundle)[:-1], now)
    if identity.name == OWN_NODE or not authority.authority.is_root:
        raise ConfigurationError(
            f"{identity.name} cannot be imported here",
            "only a root imports, and never its own node",
        )
    store, row = authority.store, certificate_row(identity)
    with store.transaction():
        _check_issuers(store, identity)
        if any(
            known.thumbprint == row.thumbprint and known.not_after >= row.not_after
            for known in store.identities.valid(row.name, now)
        ):
            return identity, False
        replace_key = row.name if row.name in replaced else None
        store.add_certificate(row, now, replace_key=replace_key)
        if replace_key is not None:
            thing_records.end_with_router(store, row.name, now)
        store.log_event("imported", row.name, f"{row.serial:x}", now)
        authority.refresh_list(now)
    return identity, True


def _check_issuers(store: Store, identity: Identity) -> None:
    """Check that its intermediate was signed by this root and is not revoked."""
    made = {row.thumbprint for row in store.identities.all() if row.name.startswith(INTERMEDIATE)}
    for issuer in identity.issuers:
        store.identities.check_not_revoked(f"the intermediate of {identity.name}", issuer)
        if issuer not in made:
            raise StoreError(
                f"the intermediate of {identity.name} is not in this record",
                "was the record restored from an older backup? make a new intermediate",
            )


def _check_in_record(authority: SigningAuthority) -> Callable[[bytes, int], None]:
    revoked = authority.store.revoked_entries()

    def check(entry: bytes, now: int) -> None:  # noqa: ARG001  (the record is always of now)
        if entry in revoked:
            raise Revoked(f"{entry.hex()} is revoked", "enroll the node with a new key")

    return check


def _serial() -> int:
    return secrets.randbits(127) + 1
