"""Nodes of foreign domains, as holders of grants: their certificates, verified and recorded.

The foreign authority says who they are, its listed root and the admitted names say how far that
counts; the grant binds the key. Without a recorded certificate a name of a foreign domain means
nothing here.
"""

from collections.abc import Iterator

from ca import svid
from ca.certificates import Identity, from_pem
from ca.domains.aliases import alias_of, split_alias
from ca.domains.anchors import ListedDomain
from ca.patterns import covers
from ca.store.record import Store
from grants.policy.model import Subject
from rossec.errors import ConfigurationError


def verify(store: Store, alias: str, pem: bytes, now: int) -> tuple[Identity, bytes]:
    """The identity a certificate of the node `alias` proves, and the thumbprint of its root.

    Raises:
        DomainUnknown: no trusted domain has the label.
        NotAdmitted: the trust has ended, or does not extend to the name.
        CertificateRefused: not a certificate below the listed root, or invalid now.
        ConfigurationError: it is another node's.
    """
    found = split_alias(alias)
    if found is None:
        raise ConfigurationError(f"{alias} is a node of this domain", "leave --certificate out")
    row = store.domains.get(found[0])
    entry = row.read()
    chain = [each for each in from_pem(pem) if each != entry.root]
    identity = ListedDomain(entry, entry.anchor).verify(chain, now)
    if identity.name != alias:
        raise ConfigurationError(
            f"the certificate is that of {found[0]}:{identity.certified_name}", "name that node"
        )
    return identity, row.root


def holder(store: Store, alias: str, now: int) -> bytes:
    """The key of a foreign node, by the newest certificate of it in the record.

    Raises:
        ConfigurationError: there is none that is valid.
        DomainUnknown: no trusted domain has the label.
    """
    if found := split_alias(alias):
        store.domains.get(found[0])
    for subject in subjects(store, now):
        if subject.name == alias:
            return subject.key
    raise ConfigurationError(
        "no valid certificate of this node is recorded here", "give its node.pem: --certificate"
    )


def subjects(store: Store, now: int) -> Iterator[Subject]:
    """The foreign nodes that are admitted now, by alias, with the key of the newest certificate."""
    revoked = store.revoked_entries()
    for row in store.domains.accepted():
        entry = row.read()
        if now >= entry.until:
            continue
        newest = {each.name: each for each in store.domains.certificates(row.root)}
        for name, each in sorted(newest.items()):
            start, end = svid.validity(svid.parse(each.der))
            admitted = any(covers(pattern, name) for pattern in entry.admitted)
            if admitted and start <= now <= end and each.thumbprint not in revoked:
                yield Subject(alias_of(entry.label, name), each.thumbprint)
