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


def split(alias: str) -> tuple[str, str]:
    """The label and the name there.

    Raises:
        ConfigurationError: a node of this domain.
    """
    found = split_alias(alias)
    if found is None:
        raise ConfigurationError(f"{alias} is a node of this domain", "leave --certificate out")
    return found


def verify(store: Store, alias: str, pem: bytes, now: int) -> tuple[Identity, bytes]:
    """The identity a certificate of the node `alias` proves, and the thumbprint of its root.

    Raises:
        DomainUnknown: no trusted domain has the label.
        NotAdmitted: the trust has ended, or does not extend to the name.
        CertificateRefused: not a certificate below the listed root, or invalid now.
        ConfigurationError: it is another node's.
    """
    label, _ = split(alias)
    row = store.domains.get(label)
    entry = row.read()
    chain = [each for each in from_pem(pem) if each != entry.root]
    identity = ListedDomain(entry, entry.anchor).verify(chain, now)
    if identity.name != alias:
        raise ConfigurationError(
            f"the certificate is that of {label}:{identity.certified_name}", "name that node"
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


def unrevoked_keys(store: Store, root: bytes, alias: str) -> frozenset[bytes]:
    """The keys of a foreign node that are recorded below the root key `root` and not revoked.

    Also those of certificates that are not valid: keys live longer.

    Raises:
        ConfigurationError: there are none.
    """
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
        "give its node.pem: --certificate; or end all of it:"
        f" rossec domain limit {label} --admit PATTERN",
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
