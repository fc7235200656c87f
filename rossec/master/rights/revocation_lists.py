"""Revocation lists at the master: in force, held by nodes, and queried. Pure.

The master is its own source of freshness: it confirms the list it holds, and signs the timestamps
that prove to nodes that no newer list is being withheld. What nodes say they hold is used not to
send a list again, and to tell the authority how far a list has come: a node that lies about it is
sent no list and becomes stale by itself. An answer to a query of RFC 9770 is information, not proof:
nodes rely on the list signed by the authority.
"""

import hashlib
from collections import deque
from collections.abc import Callable, Generator, Iterable, Sequence
from typing import Final, NamedTuple

from ca.bounded import Newest
from ca.certificates import TrustAnchor
from ca.encoding import Value, decode, encode
from ca.errors import EncodingError, RevocationRefused
from ca.keys.signing import Signer
from ca.revocation.lists import (
    MAX_AGE,
    Timestamp,
    TreeEntries,
    digest,
    finished,
    is_tree,
    open_tree,
    sign_timestamp,
)
from ca.revocation.trust_status import Revocations
from grants.model import Grant
from rossec.errors import RossecError
from rossec.master.rights.caller import CertifiedPeer

MAX_HELD_LISTS: Final = 16 * 1024  # nodes whose list is recorded
SILENT_AFTER: Final = 35  # seconds; a node says every 10 s what it holds


class ListStatus(NamedTuple):
    nodes: int
    holding: int
    lacking: tuple[str, ...]


class HeldLists:
    def __init__(self) -> None:
        self._held: dict[tuple[str, bytes], tuple[bytes, int]] = {}

    def record(self, peer: CertifiedPeer, digest: bytes, now: int) -> None:
        key = peer.name, peer.thumbprint
        if len(self._held) >= MAX_HELD_LISTS and key not in self._held:
            self._held.clear()  # a wildcard identity has as many names as it wants
        self._held[key] = digest, now

    def holds(self, peer: CertifiedPeer, digest: bytes) -> bool:
        return self._held.get((peer.name, peer.thumbprint), (None, 0))[0] == digest

    def keep_only(self, thumbprints: frozenset[bytes]) -> None:
        self._held = {key: held for key, held in self._held.items() if key[1] in thumbprints}

    def trust_status(self, connected: Iterable[CertifiedPeer], digest: bytes, now: int) -> ListStatus:
        # Nodes of a wildcard identity count one by one, as long as they speak. An identity that is connected
        # and silent counts as one node that does not hold the list.
        speaking: dict[bytes, list[tuple[str, bool]]] = {}
        for (name, key), (held, at) in self._held.items():
            if now - at <= SILENT_AFTER:
                speaking.setdefault(key, []).append((name, held == digest))
        identities = {peer.thumbprint: peer.name for peer in connected}
        found = [node for key, name in identities.items() for node in speaking.get(key, [(name, False)])]
        lacking = sorted(name for name, holds in found if not holds)
        return ListStatus(len(found), len(found) - len(lacking), tuple(lacking))


_PUBLISH: Final = "deliver it with: rossec ca publish"
_REMEMBERED: Final = 64  # refused entries, by their digest


class ListInForce:
    """One authority's list or tree, and who holds it; `persist` is called before a list takes effect."""

    def __init__(
        self,
        anchor: TrustAnchor,
        signer: Signer,
        revocations: Revocations,
        persist: Callable[[bytes], None],
        persist_entries: Callable[[bytes], object] = lambda _data: None,
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
        return self._revocations.entries

    def current(self, now: int) -> tuple[bytes, bytes]:
        revocations = self._revocations.current
        if revocations is None:
            return b"", b""
        if self._timestamp_cache[0] != now:
            self._timestamp_cache = now, sign_timestamp(self._signer, self._timestamp(now))
        return self._revocations.data, self._timestamp_cache[1]

    def revocations_for(self, peer: CertifiedPeer, now: int) -> tuple[bytes, bytes]:
        data, stamp = self.current(now)
        return (b"" if self.held_lists.holds(peer, self._revocations.digest) else data), stamp

    def record_taken(self, peer: CertifiedPeer, data: bytes, now: int) -> None:
        """Note that a node has taken a list that was sent to it."""
        is_current = data is self._revocations.data  # nearly always: a thousand nodes take the same octets
        self.held_lists.record(peer, self._revocations.digest if is_current else digest(data), now)

    def trust_status(self, connected: Iterable[CertifiedPeer], now: int) -> ListStatus:
        return self.held_lists.trust_status(connected, self._revocations.digest, now)

    @property
    def list_data(self) -> bytes:
        return b"" if self._revocations.current is None else self._revocations.data

    @property
    def tree_entries(self) -> bytes:
        return b"" if self._listing is None else self._listing.encoded()

    @property
    def list_number(self) -> tuple[int, int]:
        current = self._revocations.current
        return (0, 0) if current is None else current.number

    @property
    def number(self) -> int:
        return 0 if self._revocations.current is None else self._revocations.current.seq

    def update(self, data: bytes, now: int) -> bool:
        if is_tree(data):
            raise RevocationRefused("a revocation tree needs its entries", _PUBLISH)
        before = self._revocations.data
        self._revocations.update(data, now, self._persist)
        self._listing = None
        return self._list_replaced(before)

    def update_tree(self, data: bytes, entries: bytes, now: int) -> bool:
        return finished(self.take_tree(data, entries, now))

    def take_tree(self, data: bytes, entries: bytes, now: int) -> Generator[None, None, bool]:
        # As `update_tree`, in steps.
        # What costs least is compared first: the octets, the signature, the number, the size.
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
        return [] if self._listing is None else [self._listing.prove(item) for item in entries]

    def _list_replaced(self, before: bytes) -> bool:
        self._timestamp_cache = (-1, b"")
        return self._revocations.data != before

    def _timestamp(self, now: int) -> Timestamp:
        return Timestamp(self.number, self._revocations.digest, now, MAX_AGE)


def pertaining(
    entries: frozenset[bytes], grants: Iterable[Grant], own: tuple[bytes, bytes | None], names: Iterable[str]
) -> Generator[None, None, frozenset[bytes]]:
    # The `entries` that pertain to a caller that is registered for `names` (RFC 9770). Its own grants; grants
    # of any holder for these names, and the keys of these holders; the delegation of renewal. Yields where
    # other calls may be answered.
    found, keys = set(own), frozenset(names)
    for grant in [item for item in grants if not entries.isdisjoint(entries_of(item))]:
        is_found = grant.holder == own[0]
        for permission in () if is_found else grant.permissions:
            is_found = any(permission.matches(name, permission.rights) for name in keys)
            if is_found:
                break
            yield
        if is_found:
            found |= entries_of(grant)
    return entries & found


def entries_of(grant: Grant) -> frozenset[bytes]:
    links = (entry for link in grant.links for entry in (link.id, link.holder))
    return frozenset((grant.holder, *links))


MAX_N: Final = 64  # updates stored for one requester
MAX_DIFF_BATCH: Final = 16  # updates in one answer
MAX_HASHES: Final = 4096  # token hashes in one answer, unless one update alone has more
MAX_REQUESTERS: Final = 1024
MAX_QUERY: Final = 64  # bytes

# Parameters of the answer, RFC 9770 section 14.1.
_FULL_SET, _DIFF_SET, _CURSOR, _MORE = 0, 1, 2, 3


class TrlUpdate(NamedTuple):
    number: int
    removed: tuple[bytes, ...]
    added: tuple[bytes, ...]


class Query(NamedTuple):
    diff: int | None = None
    cursor: int | None = None


class Series:
    def __init__(self, first: int, entries: frozenset[bytes]) -> None:
        self._next = first
        self._entries = entries
        self._updates: deque[TrlUpdate] = deque(maxlen=MAX_N)

    def note(self, entries: frozenset[bytes]) -> None:
        if entries == self._entries:
            return
        removed, added = sorted(self._entries - entries), sorted(entries - self._entries)
        self._updates.append(TrlUpdate(self._next, tuple(removed), tuple(added)))
        self._entries = entries
        self._next += 1

    def answer(self, query: Query) -> dict[int | str, Value]:
        last = self._updates[-1].number if self._updates else None
        if query.diff is None:
            return {_FULL_SET: [*sorted(self._entries)], _CURSOR: last}
        if query.cursor is None:
            wanted = list(self._updates)[-min(query.diff or MAX_N, MAX_N) :]
        elif last is None or query.cursor < self._updates[0].number - 1:
            # The cursor is too old: `more` tells the requester to send a full query.
            return {_DIFF_SET: [], _CURSOR: None, _MORE: last is not None}
        elif query.cursor > last:
            raise RossecError("a cursor that was never sent (2)")
        else:
            wanted = [update for update in self._updates if update.number > query.cursor]
            wanted = wanted[: query.diff or MAX_N]
        batch: list[TrlUpdate] = []
        hashes = 0
        for update in wanted[:MAX_DIFF_BATCH]:
            hashes += len(update.removed) + len(update.added)
            if batch and hashes > MAX_HASHES:
                break
            batch.append(update)
        cursor = batch[-1].number if batch else last
        diffs: list[Value] = [[[*item.removed], [*item.added]] for item in reversed(batch)]
        return {_DIFF_SET: diffs, _CURSOR: cursor, _MORE: len(batch) < len(wanted)}


class RevocationQueries:
    """TRL queries of RFC 9770: full query, diff query, with a cursor."""

    # Each requester has a numbered series of updates of *its* part of the TRL; the answer is that part, or
    # the updates after a cursor. An update is recorded when the requester queries and its part has changed
    # since, so nothing is stored for peers that never query. The first number is taken from the start time of
    # the master, so a cursor of an earlier run is recognized as too old.
    def __init__(self, start: int) -> None:
        self._first = start << 20  # reached by a later run only after a million updates a second
        self._series: Newest[bytes, Series] = Newest(MAX_REQUESTERS)

    def answer(self, requester: bytes, entries: frozenset[bytes], query: bytes) -> bytes:
        """Answer one query of the requester whose part of the TRL is `entries`."""
        parsed = read_query(query)
        series = self._series.use(requester)
        if series is None:
            series = self._series[requester] = Series(self._first, entries)
        series.note(entries)
        return encode(series.answer(parsed))


def read_query(query: bytes) -> Query:
    try:
        value = decode(query, limit=MAX_QUERY)
    except EncodingError as error:
        raise RossecError(f"not a query: {error} (0)") from None
    if not isinstance(value, dict) or value.keys() - {"diff", "cursor"}:
        raise RossecError("a query is a map of diff and cursor (1)")
    if any(type(number) is not int or number < 0 for number in value.values()):
        raise RossecError("diff and cursor are non-negative integers (0)")
    if "cursor" in value and "diff" not in value:
        raise RossecError("a cursor without diff (1)")
    return Query(**value)  # type: ignore[arg-type]
