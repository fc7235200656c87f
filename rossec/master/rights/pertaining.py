"""Which revoked entries pertain to a caller (RFC 9770): the others it need not know. Pure."""

from collections.abc import Generator, Iterable

from grants.model import Grant


def pertaining(
    entries: frozenset[bytes],
    grants: Iterable[Grant],
    own: tuple[bytes, bytes | None],
    names: Iterable[str],
) -> Generator[None, None, frozenset[bytes]]:
    """The `entries` that pertain to a caller that is registered for `names`.

    Its own grants; grants of any holder for these names, and the keys of these holders; the
    delegation of renewal. Yields where other calls may be answered.

    Args:
        grants: those that were presented to the master: it does not know the others.
        own: the thumbprint of the caller's key, and the id of the delegation.
    """
    found, keys = set(own), frozenset(names)
    revoked = [item for item in grants if not entries.isdisjoint(entries_of(item))]
    for grant in revoked:
        if grant.holder == own[0] or (yield from _names_any(grant, keys)):
            found |= entries_of(grant)
    return entries & found


def entries_of(grant: Grant) -> frozenset[bytes]:
    """The ids of a grant and of its links, and the keys they are for."""
    links = (entry for link in grant.links for entry in (link.id, link.holder))
    return frozenset((grant.holder, *links))


def _names_any(grant: Grant, names: frozenset[str]) -> Generator[None, None, bool]:
    for permission in grant.permissions:
        if any(permission.matches(name, permission.rights) for name in names):
            return True
        yield
    return False
