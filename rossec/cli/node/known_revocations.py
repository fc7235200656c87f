"""What this machine knows to be revoked, without a running master: for `rossec doctor`.

The record of an authority that lives here, and the signed lists that lie in the homes of a node, of
the master and of the authority. A list is accepted when the node's own authority signed it. What is
revoked stays revoked: of several lists every entry counts.
"""

from collections.abc import Iterator
from contextlib import closing, suppress
from pathlib import Path

from ca.certificates import TrustAnchor
from ca.errors import HintedError, RevocationRefused
from ca.revocation.state import RevocationList, open_statement
from ca.revocation.tree import TreeEntries
from rossec.authority.home import AuthorityHome
from rossec.home import NodeHome
from rossec.ros.names import MASTER


def known_revocations(home: Path, node: NodeHome) -> dict[bytes, str]:
    """Each entry that is revoked, with the source that lists it."""
    anchor, found = node.anchor(), dict[bytes, str]()
    for place in (node, NodeHome.of(home, MASTER)):
        for entry in _listed(place, anchor):
            found.setdefault(entry, f"the list in {place.path}")
    for entry in _recorded(home, anchor):
        found[entry] = f"the authority's record in {home / 'ca'}"
    return found


def _listed(place: NodeHome, anchor: TrustAnchor) -> Iterator[bytes]:
    """What a list that was saved holds; a tree's entries are only in a master's home."""
    data = place.load_revocations()
    if data is None:
        return
    with suppress(RevocationRefused):  # a list of another authority does not concern this node
        statement = open_statement(data, anchor.public_key)
        if isinstance(statement, RevocationList):
            yield from statement.entries
        elif (entries := place.load_entries()) is not None:
            listing = TreeEntries.read(entries)
            listing.check(statement)
            yield from listing.entries


def _recorded(home: Path, anchor: TrustAnchor) -> frozenset[bytes]:
    """Of the authority itself, if it is the node's and not an intermediate below it."""
    with suppress(HintedError):
        authority = AuthorityHome.at(home)
        if authority.anchor().thumbprint == anchor.thumbprint and not authority.is_intermediate:
            with closing(authority.store()) as store:
                return store.revoked_entries()
    return frozenset()
