"""The entries that the signed revocation list must have, and those that the newest one lacks.

They are computed from the record: everything revoked that could still be valid. A list is outdated
when it lacks one of these entries; their order does not matter. A tree does not contain its
entries; they are those of the record if they give the signed root.
"""

from typing import Final

from cryptography.hazmat.primitives.asymmetric import ec

from ca.errors import RevocationRefused
from ca.revocation.state import RevocationList, open_statement
from ca.revocation.tree import RevocationTree, TreeEntries
from ca.store.record import Store
from grants import document

SKEW: Final = 60  # seconds that another host's clock may be behind


def required_entries(store: Store, now: int) -> frozenset[bytes]:
    """The entries of a list signed at `now`.

    Grants that have expired and cannot be renewed are left out, and so are statements about things.
    A node refuses a list from its future, so a node without the entry finds the grant expired (RFC
    9770 removes entries in the same way). Keys stay: they are few, and a certificate renewed by the
    master may be valid longer than those recorded here.
    """
    ended = (row.id for row in store.revoked_grants() if document.peek(row.data).cap + SKEW < now)
    expired = (row.id for row in store.things.revoked() if row.expires + SKEW < now)
    return store.revoked_entries() - frozenset(ended) - frozenset(expired)


def missing_entries(store: Store, key: ec.EllipticCurvePublicKey, now: int) -> frozenset[bytes]:
    """The entries that the newest signed list lacks; all, where that is unknown.

    `key` is the authority's.

    Raises:
        RevocationRefused: the list in the record is not signed by the authority.
    """
    with store.database.read_transaction():
        data = store.newest_list()
        statement = None if data is None else open_statement(data, key)
        return required_entries(store, now) - _listed_entries(store, statement)


def tree_entries(store: Store, tree: RevocationTree) -> TreeEntries:
    """The entries of a signed tree, from the record.

    Raises:
        RevocationRefused: those in the record do not give its root.
    """
    listing = TreeEntries(required_entries(store, tree.issued))
    listing.check(tree)
    return listing


def _listed_entries(
    store: Store, statement: RevocationList | RevocationTree | None
) -> frozenset[bytes]:
    match statement:
        case RevocationList(entries=entries):
            return entries
        case RevocationTree():
            try:
                return tree_entries(store, statement).entries
            except RevocationRefused:
                return frozenset()
        case _:
            return frozenset()
