"""Successors, signed and recorded: of identities, of the authority's own node, and intermediates.

A node signs the request with its old key (`ca.certificates`) and gets one answer per request, and
no further certificate while the newest one is not due; an operator renews by name, for the current
key of the name. The old identity is looked up in the transaction that records the successor: a key
that is revoked meanwhile gets none.
"""

import contextlib
import secrets
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Final

from ca import certificates, svid
from ca.authority import DAY, LIFETIME, MAX_LIFETIME, Authority
from ca.errors import CAError, Revoked, StoreError
from ca.keys import private_keys
from ca.keys.signing import KeySigner
from ca.store.record import CertificateRow, Store
from ca.store.values import INTERMEDIATE
from rossec import files
from rossec.authority import signing
from rossec.authority.home import OWN_LIFETIME, AuthorityHome
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
    """Answer a node's renewal (`ca.certificates.sign_renewal`) with its new bundle (PEM)."""
    # `check(entry, now)` raises for revoked entries; the default uses the authority's record. The host of
    # an intermediate has no such record and passes `Revocations.check`.
    with authority.store.transaction():
        return _renew(authority, data, now, check or _check_in_record(authority), lifetime)


def renew_recorded(authority: SigningAuthority, data: bytes, now: int) -> bytes:
    with authority.store.transaction():
        check = _check_in_record(authority)
        renewal = certificates.open_renewal(data, authority.authority.anchor, now, check)
        identity = renewal.identity
        rows = authority.store.identities.by_name(identity.name)
        if not rows:
            raise CAError(
                f"{identity.name} is not in the authority's record",
                "was it enrolled by an intermediate? where the authority is: rossec ca import NODE.pem",
            )
        newest = rows[-1]
        if (newest.thumbprint, newest.wildcard) != (identity.thumbprint, identity.wildcard):
            raise CAError(
                f"{identity.name} has a newer identity, with another key or for other names",
                f"see, where the authority is: rossec ca show {identity.name}",
            )
        return _renew(authority, data, now, check, MAX_LIFETIME)


def _renew(
    authority: SigningAuthority, data: bytes, now: int, check: Callable[[bytes, int], None], lifetime: int
) -> bytes:
    renewal = certificates.open_renewal(data, authority.authority.anchor, now, check)
    answered = authority.store.identities.issued_for(renewal.request.digest)
    if answered is not None:
        return authority.issued_bundle(answered, now, wildcard=renewal.identity.wildcard)
    # A newer identity for the same key that is not due itself is the answer to other requests. Otherwise a
    # node could have any number signed and recorded, as long as its old one is valid.
    for row in reversed(authority.store.identities.valid(renewal.identity.name, now)):
        is_newer = row.thumbprint == renewal.request.thumbprint and row.not_after > renewal.identity.not_after
        is_due = now >= certificates.renew_at(row.not_before, row.not_after)
        is_own = authority.store.identities.issuer(row) is None
        if is_newer and not is_due and is_own and row.wildcard is renewal.identity.wildcard:
            return authority.bundle(row.der)
    der = authority.authority.renew(renewal, now=now, serial=_serial(), lifetime=lifetime)
    made, old = certificate_row(authority.verify(der, now)), renewal.identity.thumbprint
    authority.store.add_certificate(made, now, request=renewal.request.digest, renews=old)
    authority.refresh_list(now)  # the key may be that of a master
    return authority.bundle(der)


def renew_by_name(
    authority: SigningAuthority, name: str, now: int, lifetime: int = LIFETIME, *, expired: bool = False
) -> bytes:
    """Certify the current key of `name` again; returns the node's new bundle (PEM)."""
    # A node enrolled by an intermediate is then certified by this authority, for the same key. With
    # `expired`, the newest identity may have ended: its key, and so its grants, are kept.
    authority.refresh_list(now)
    with authority.store.transaction():
        held = authority.store.renewable_certificate(name, now, expired=expired)
        at, signer = min(now, held.not_after), authority.store.identities.issuer(held)
        identity = (
            authority.verify(held.der, at)
            if signer is None
            else authority.authority.anchor.verify([held.der, signer.der], at)
        )
        der = authority.authority.reissue(
            identity, identity.public_key, now=now, serial=_serial(), lifetime=lifetime
        )
        row = certificate_row(authority.verify(der, now))
        authority.store.add_certificate(row, now, renews=held.thumbprint)
    return authority.bundle(der)


def renew_own_node(authority: SigningAuthority, now: int) -> int:
    own = NodeHome(authority.path / "node", OWN_NODE)
    key = KeySigner(private_keys.load_private(own.path / "node.key"))
    request = svid.build_request(key, authority.domain, OWN_NODE)
    return own.install(authority.issue(request, now, OWN_LIFETIME), now).not_after


def own_node_is_due(authority: SigningAuthority, now: int) -> bool:
    rows = authority.store.identities.by_name(OWN_NODE)
    return bool(rows) and now >= certificates.renew_at(rows[-1].not_before, rows[-1].not_after)


def sign_intermediate(
    authority: SigningAuthority,
    csr: bytes,
    now: int,
    *,
    may_enroll: bool,
    lifetime: int = INTERMEDIATE_LIFETIME,
) -> tuple[str, bytes]:
    authority.refresh_list(now)
    root = authority.authority
    der = root.issue_intermediate(csr, now=now, serial=_serial(), may_enroll=may_enroll, lifetime=lifetime)
    made = root.anchor.read_intermediate(der)
    name = f"{INTERMEDIATE}{made.thumbprint.hex()[:16]}"
    row = CertificateRow(made.serial, name, made.thumbprint, der, made.not_before, made.not_after)
    authority.store.add_certificate(row, now, renews=made.thumbprint)
    return name, authority.bundle(der)


def import_identity(
    authority: SigningAuthority, bundle: bytes, now: int, replaced: Collection[str] = ()
) -> tuple[certificates.Identity, bool]:
    """Record an identity signed by an intermediate of this root; the boolean says if it is new."""
    # `replaced` are names whose current key may be replaced; that key is revoked.
    identity = authority.authority.anchor.verify(certificates.from_pem(bundle)[:-1], now)
    if identity.name == OWN_NODE or not authority.authority.is_root:
        raise ConfigurationError(
            f"{identity.name} cannot be imported here", "only a root imports, and never its own node"
        )
    store, row = authority.store, certificate_row(identity)
    with store.transaction():
        # Its intermediate was signed by this root, and is not revoked.
        made = {row.thumbprint for row in store.identities.all() if row.name.startswith(INTERMEDIATE)}
        for issuer in identity.issuers:
            store.identities.check_not_revoked(f"the intermediate of {identity.name}", issuer)
            if issuer not in made:
                raise StoreError(
                    f"the intermediate of {identity.name} is not in this record",
                    "was the record restored from an older backup? make a new intermediate",
                )
        if any(
            known.thumbprint == row.thumbprint and known.not_after >= row.not_after
            for known in store.identities.valid(row.name, now)
        ):
            return identity, False
        replace_key = row.name if row.name in replaced else None
        store.add_certificate(row, now, replace_key=replace_key)
        if replace_key is not None:
            signing.end_with_router(store, row.name, now)
        store.log_event("imported", row.name, f"{row.serial:x}", now)
        authority.refresh_list(now)
    return identity, True


def _check_in_record(authority: SigningAuthority) -> Callable[[bytes, int], None]:
    revoked = authority.store.revoked_entries()

    def check(entry: bytes, now: int) -> None:  # noqa: ARG001  (the record is always of now)
        if entry in revoked:
            raise Revoked(f"{entry.hex()} is revoked", "enroll the node with a new key")

    return check


def _serial() -> int:
    return secrets.randbits(127) + 1


REQUEST: Final = "intermediate.csr"
OWNED: Final = (files.Owned(r"intermediate\.csr"), files.Owned(r"intermediate\.pem", public=True))


def begin(home: Path, domain: str, passphrase: str) -> Path:
    path = home / "ca"
    if (path / "ca.pem").exists():
        raise ConfigurationError(
            f"there is an authority in {path}, whose service renews identities: rossec ca serve",
            "for an intermediate on another host, there: ROSSEC_HOME=~/intermediate rossec ca"
            f" intermediate request {domain}",
        )
    files.make_private_directory(path)
    key = private_keys.generate()
    request = certificates.build_intermediate_request(KeySigner(key), domain)
    private_keys.write_private(path / "ca.key", key, passphrase)
    files.create(path / REQUEST, request, 0o644)
    return path / REQUEST


def install(home: Path, bundle: bytes, passphrase: str, now: int) -> certificates.Intermediate:
    path = home / "ca"
    found = certificates.from_pem(bundle)
    if len(found) != 2:
        raise ConfigurationError(
            f"a bundle of {len(found)} certificates where two are expected",
            "take the file `rossec ca intermediate sign` wrote",
        )
    der, root = found
    anchor = certificates.TrustAnchor.load(root)
    made = anchor.check_intermediate(der, now)
    signer = KeySigner(private_keys.load_private(path / "ca.key", passphrase))
    Authority(signer, root, der)
    if (path / "ca.pem").exists() and AuthorityHome(path).anchor().thumbprint != anchor.thumbprint:
        raise ConfigurationError(
            "this is the intermediate of another root", "start again in another ROSSEC_HOME"
        )
    if not (path / "ca.db").exists():
        Store.create(path / "ca.db").close()
    files.replace(path / "intermediate.pem", certificates.to_pem(der), 0o644)
    files.replace(path / "ca.pem", certificates.to_pem(root), 0o644)
    with contextlib.closing(Store.open(path / "ca.db")) as store:
        store.log_event("installed", "intermediate", made.thumbprint.hex(), now)
    return made
