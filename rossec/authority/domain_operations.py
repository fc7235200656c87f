"""What an authority does about foreign domains and their nodes, as holders of grants.

Terms are recorded and the list signed in one transaction. A label that grants name is not given to
another domain while one of these can live: they would then speak of its nodes. Whoever has another
root key is another domain, whatever it is called. The foreign authority says who its nodes are, its
listed root and the admitted names say how far that counts; the grant binds the key. Without a
recorded certificate a foreign name means nothing here.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

from ca import certificates, svid
from ca.domains import (
    TRUST_BUNDLE_LIFETIME,
    DomainList,
    ForeignDomain,
    ListedDomain,
    TrustBundle,
    sign_bundle,
)
from ca.errors import DomainUnknown
from ca.names import alias_of, pattern_covers, split_alias
from ca.revocation.lists import RevocationList
from ca.store.record import GrantRow, Store
from ca.store.signed_statements import DomainRow
from grants import document
from rossec.authority.session import AuthoritySession
from rossec.authority.signing import SKEW
from rossec.clock import format_time
from rossec.errors import ConfigurationError

if TYPE_CHECKING:
    from grants.policy.model import Subject


class Removed(NamedTuple):
    """A domain that is not trusted any more, and the ids of its grants that were revoked."""

    row: DomainRow
    revoked: frozenset[bytes]


class Domains:
    def __init__(self, session: AuthoritySession) -> None:
        self._session = session

    def bundle(
        self, names: tuple[str, ...], masters: tuple[str, ...] = (), lifetime: int = TRUST_BUNDLE_LIFETIME
    ) -> bytes:
        authority, at = self._session.unlock(), self._session.now()
        root = authority.authority.anchor.certificate
        return sign_bundle(authority.signer, TrustBundle(root, names, masters, at, at + lifetime))

    def accept(self, domain: ForeignDomain) -> DomainList:
        authority, at = self._session.unlock(), self._session.now()
        with authority.store.transaction():
            authority.store.domains.accept(domain, at)
            root = domain.anchor.thumbprint
            former = [row for row in authority.store.domains.labelled(domain.label) if row.root != root]
            given = living_grants(authority.store, domain.label, at) if former else []
            if given:
                last = max(document.peek(row.data).cap for row in given)
                count = f"{len(given)} grants name" if len(given) > 1 else "a grant names"
                raise ConfigurationError(
                    f"{count} {domain.label} and mean{'s' * (len(given) == 1)} {former[-1].domain},"
                    f" until {format_time(last)}",
                    f"choose another label, or revoke: rossec grant revoke {given[0].id.hex()[:8]}",
                )
            return authority.sign_domains(at)

    def changed(self, label: str, **changes: Any) -> ForeignDomain:
        # What the terms of a trusted domain would be; see `limit`.
        with self._session.record() as store:
            return replace(store.domains.get(label).read(), **changes)

    def limit(self, label: str, **changes: Any) -> DomainList:
        authority, at = self._session.unlock(), self._session.now()
        with authority.store.transaction():
            held = authority.store.domains.get(label).read()
            authority.store.domains.accept(replace(held, **changes), at)
            return authority.sign_domains(at)

    def remove(self, label: str, reason: str, *, revoke_grants: bool) -> Removed:
        authority, at = self._session.unlock(), self._session.now()
        with authority.store.transaction():
            row = authority.store.domains.end(label, reason, at)
            given = living_grants(authority.store, label, at) if revoke_grants else []
            revoked = frozenset(grant.id for grant in given)
            if revoked:
                authority.revoke_all(revoked, f"domain {label} was removed", at)
            authority.sign_domains(at)
        return Removed(row, revoked)

    def revoke_foreigner(
        self, alias: str, reason: str, certificate: bytes = b""
    ) -> tuple[RevocationList, int]:
        # All that are recorded, or the one in `certificate` (PEM), which is recorded with it. It needs
        # nothing from the other domain, whose trust may have ended.
        authority, at = self._session.unlock(), self._session.now()
        store = authority.store
        with store.transaction():
            if certificate:
                identity, root = verify(store, alias, certificate, at)
                store.domains.add_certificate(root, identity, at)
                keys = frozenset({identity.thumbprint})
            else:
                label, _ = split(alias)
                root = find_row(store, label).root
                keys = unrevoked_keys(store, root, alias)
            return authority.revoke_all(keys, reason, at), len(keys)


def split(alias: str) -> tuple[str, str]:
    found = split_alias(alias)
    if found is None:
        raise ConfigurationError(f"{alias} is a node of this domain", "leave --certificate out")
    return found


def verify(store: Store, alias: str, pem: bytes, now: int) -> tuple[certificates.Identity, bytes]:
    label, _ = split(alias)
    row = store.domains.get(label)
    entry = row.read()
    chain = [each for each in certificates.from_pem(pem) if each != entry.root]
    identity = ListedDomain(entry, entry.anchor).verify(chain, now)
    if identity.name != alias:
        raise ConfigurationError(
            f"the certificate is that of {label}:{identity.certified_name}", "name that node"
        )
    return identity, row.root


def holder(store: Store, alias: str, now: int) -> bytes:
    if found := split_alias(alias):
        store.domains.get(found[0])
    for subject in subjects(store, now):
        if subject.name == alias:
            return subject.key
    raise ConfigurationError(
        "no valid certificate of this node is recorded here", "give its node.pem: --certificate"
    )


def unrevoked_keys(store: Store, root: bytes, alias: str) -> frozenset[bytes]:
    """The keys of a foreign node that are recorded below the root key `root` and not revoked."""
    # Also those of certificates that are not valid: keys live longer.
    label, name = split(alias)
    known = store.domains.certificates(root)
    keys = frozenset(each.thumbprint for each in known if each.name == name)
    if left := keys - store.revoked_entries():
        return left
    if keys:
        raise ConfigurationError(
            f"every recorded key of {label}:{name} is revoked already",
            "if it has another one: --certificate with its node.pem; to deliver the list again:"
            " rossec ca publish",
        )
    raise ConfigurationError(
        f"no certificate of {label}:{name} is recorded here",
        f"give its node.pem: --certificate; or end all of it: rossec domain limit {label} --admit PATTERN",
    )


def subjects(store: Store, now: int) -> Iterator["Subject"]:
    from grants.policy.model import Subject  # noqa: PLC0415 - a fifth of the start of every other command

    revoked = store.revoked_entries()
    for row in store.domains.accepted():
        entry = row.read()
        if now >= entry.until:
            continue
        newest = {each.name: each for each in store.domains.certificates(row.root)}
        for name, each in sorted(newest.items()):
            start, end = svid.validity(svid.parse(each.der))
            admitted = any(pattern_covers(pattern, name) for pattern in entry.admitted)
            if admitted and start <= now <= end and each.thumbprint not in revoked:
                yield Subject(alias_of(entry.label, name), each.thumbprint)


def living_grants(store: Store, label: str, now: int) -> list[GrantRow]:
    return [
        row
        for row in store.unrevoked_grants()
        if (found := split_alias(row.name)) is not None
        and found[0] == label
        and document.peek(row.data).cap + SKEW >= now
    ]


def find_row(store: Store, label: str) -> DomainRow:
    try:
        return store.domains.get(label)
    except DomainUnknown:
        former = store.domains.labelled(label)
        if not former:
            raise
        return former[-1]
