"""The own revocation list at the master: in force, confirmed, and sent with timestamps. Pure.

The master is its own source of freshness: it confirms the list it holds, and signs the timestamps
that prove to nodes that no newer list is being withheld.
"""

import hashlib
from collections import deque
from collections.abc import Callable, Generator, Iterable, Sequence
from typing import Final

from ca.certificates import TrustAnchor
from ca.errors import RevocationRefused
from ca.keys.signer import Signer
from ca.revocation.state import MAX_AGE, Revocations, Timestamp, digest, sign_timestamp
from ca.revocation.tree import TreeEntries, finished, is_tree, open_tree
from rossec.master.rights.caller import Peer
from rossec.master.rights.delegation import discard
from rossec.master.rights.held_lists import HeldLists, ListStanding

_PUBLISH: Final = "deliver it with: rossec ca publish"
_REMEMBERED: Final = 64  # refused entries, by their digest


class ListInForce:
    """One authority's list or tree, and who holds it.

    Args:
        anchor: the authority.
        signer: the master's own identity key; signs timestamps.
        revocations: loaded with what was persisted, if anything.
        persist: makes a list durable; called before the list takes effect.
        persist_entries: makes the entries of a tree durable, before the tree itself.
    """

    def __init__(
        self,
        anchor: TrustAnchor,
        signer: Signer,
        revocations: Revocations,
        persist: Callable[[bytes], None],
        persist_entries: Callable[[bytes], None] = discard,
    ) -> None:
        self._anchor = anchor
        self._signer = signer
        self._revocations = revocations
        self._persist = persist
        self._persist_entries = persist_entries
        self._listing: TreeEntries | None = None
        self._refused_entries: deque[tuple[bytes, bytes]] = deque(maxlen=_REMEMBERED)
        self.held_lists = HeldLists()
        self._timestamp_cache: tuple[int, bytes] = (-1, b"")

    def revoked(self) -> frozenset[bytes]:
        """All revoked entries."""
        return self._revocations.entries

    def current(self, now: int) -> tuple[bytes, bytes]:
        """The list and a timestamp of this second; empty while there is no list."""
        revocations = self._revocations.current
        if revocations is None:
            return b"", b""
        if self._timestamp_cache[0] != now:
            self._timestamp_cache = now, sign_timestamp(self._signer, self._timestamp(now))
        return self._revocations.data, self._timestamp_cache[1]

    def revocations_for(self, peer: Peer, now: int) -> tuple[bytes, bytes]:
        """As `current`, but without the list if the node has said that it holds it."""
        data, stamp = self.current(now)
        return (b"" if self.held_lists.holds(peer, digest(data)) else data), stamp

    def standing(self, connected: Iterable[Peer], now: int) -> ListStanding:
        """How many of the `connected` hold the list in force."""
        return self.held_lists.standing(connected, digest(self._revocations.data), now)

    @property
    def list_data(self) -> bytes:
        """The signed list or tree in force, as received; empty: none."""
        return b"" if self._revocations.current is None else self._revocations.data

    @property
    def tree_entries(self) -> bytes:
        """The entries of the tree in force; empty: a list is, or they are missing."""
        return b"" if self._listing is None else self._listing.encoded()

    @property
    def list_number(self) -> tuple[int, int]:
        """Epoch and sequence number of the list in force; zeros: none."""
        current = self._revocations.current
        return (0, 0) if current is None else current.number

    @property
    def number(self) -> int:
        """Sequence number of the list in force; 0: none."""
        return 0 if self._revocations.current is None else self._revocations.current.seq

    def update(self, data: bytes, now: int) -> bool:
        """Accept a list signed by the authority; returns whether it differs from the one held.

        Raises:
            RevocationRefused: forged, malformed, or older than one seen.
        """
        if is_tree(data):
            raise RevocationRefused("a revocation tree needs its entries", _PUBLISH)
        before = self._revocations.data
        self._revocations.update(data, now, self._persist)
        self._listing = None
        return self._list_replaced(before)

    def update_tree(self, data: bytes, entries: bytes, now: int) -> bool:
        """Accept a tree signed by the authority, with all its entries; as `update`."""
        return finished(self.take_tree(data, entries, now))

    def take_tree(self, data: bytes, entries: bytes, now: int) -> Generator[None, None, bool]:
        """As `update_tree`, in steps: anybody may send this, and most of it is known or invented.

        What costs least is compared first: the octets, the signature, the number, the size.
        """
        if self._listing is not None and data == self._revocations.data:
            return False
        signed = open_tree(data, self._anchor.public_key)
        self._revocations.check_number(signed)
        refused = data, hashlib.sha256(entries).digest()
        if refused in self._refused_entries:
            raise RevocationRefused("these entries were refused before", _PUBLISH)
        try:
            listing = yield from TreeEntries.reading(entries, signed)
        except RevocationRefused:
            self._refused_entries.append(refused)
            raise
        if self._listing is not None and data == self._revocations.data:
            return False  # another caller was faster
        return self._put_in_force(data, entries, listing, now)

    def _put_in_force(self, data: bytes, entries: bytes, listing: TreeEntries, now: int) -> bool:
        before = self._revocations.data

        def persist(data: bytes) -> None:
            self._persist_entries(entries)
            self._persist(data)

        if data == before:  # after a restart without the entries
            self._persist_entries(entries)
        self._revocations.update(data, now, persist)
        self._revocations.set_entries(listing)
        self._listing = listing
        return self._list_replaced(before)

    def proofs(self, entries: Sequence[bytes]) -> list[bytes]:
        """The proof of each entry in the tree in force; empty while a list is in force."""
        return [] if self._listing is None else [self._listing.prove(item) for item in entries]

    def _list_replaced(self, before: bytes) -> bool:
        """Reset what depends on the list; returns whether it differs from `before`."""
        self._timestamp_cache = (-1, b"")
        return self._revocations.data != before

    def _timestamp(self, now: int) -> Timestamp:
        return Timestamp(self.number, digest(self._revocations.data), now, MAX_AGE)
