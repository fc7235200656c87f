"""What the signed list of revocations has to hold, and whether the newest one does.

Asked of the record alone: of everything revoked, what could still hold. A list is behind when one
of these entries is not in it; in which order they were written down says nothing. A tree does not
name its entries; they are those of the record when they lead to the root that was signed.
"""

from typing import Final

from cryptography.hazmat.primitives.asymmetric import ec

from ca.errors import RevocationRefused
from ca.revocation.state import RevocationList, open_statement
from ca.revocation.tree import RevocationTree, TreeEntries
from ca.store.record import Store
from grants import document

SKEW: Final = 60  # seconds another host's clock may be behind


def required_entries(store: Store, now: int) -> frozenset[bytes]:
    """What a list that is signed at `now` has to hold.

    Grants that no renewal can bring back need not be on it any longer. A node that relies on a list
    refuses to have a clock behind it, so whoever lacks the entry finds the grant expired (RFC 9770
    lets entries go in the same way). Keys stay: they are few, and a certificate renewed by the
    master may outlive all that are recorded here.
    """
    ended = (row.id for row in store.revoked_grants() if document.peek(row.data).cap + SKEW < now)
    return store.revoked_entries() - frozenset(ended)


def missing_entries(store: Store, key: ec.EllipticCurvePublicKey, now: int) -> frozenset[bytes]:
    """What the newest signed list lacks; everything, where that cannot be told.

    `key` is the authority's.

    Raises:
        RevocationRefused: the list in the record is none of the authority's.
    """
    with store.read_transaction():
        data = store.newest_list()
        statement = None if data is None else open_statement(data, key)
        return required_entries(store, now) - _listed_entries(store, statement)


def tree_entries(store: Store, tree: RevocationTree) -> TreeEntries:
    """The entries of a tree in the record, as they were when it was signed.

    Raises:
        RevocationRefused: the record holds others, and does not say which they were.
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
