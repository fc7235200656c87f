"""What this node knows about revocations, and whether it may rely on it.

The state fails closed: without a list, without a confirmation, after its maximum age, after the
list's own expiry, or on a clock that runs backwards, `check` refuses. It only moves forward: a
list older than the newest ever seen is refused, also after a restart, because the caller persists
the list *before* it takes effect (CVE-2025-2888 in tough was that order reversed) and hands its
number back as `floor`. Clock and disk are the caller's: `now` and `persist` are arguments.

Where the authority signed a tree instead of a list (`ca.revocation.tree`), each entry needs a
proof: until one has come nobody can tell, and what is waited for is said by `wanted`.
"""

from collections.abc import Callable
from typing import Final

from cryptography.hazmat.primitives.asymmetric import ec

from ca.errors import ClocksDisagree, RevocationRefused, RevocationsStale, Revoked, RollbackRefused
from ca.revocation.lists import (
    MAX_AGE,
    MAX_ENTRIES,
    MAX_LIST,
    RevocationList,
    Timestamp,
    check_entry,
    digest,
    open_list,
    open_timestamp,
    sign_list,
    sign_timestamp,
)
from ca.revocation.tree import RevocationTree, TreeEntries, is_revoked, is_tree, open_tree

__all__ = [
    "MAX_AGE", "MAX_ENTRIES", "MAX_LIST", "NO_FLOOR", "SKEW", "RevocationList", "Revocations",
    "Timestamp", "check_entry", "digest", "open_list", "open_statement", "open_timestamp",
    "sign_list", "sign_timestamp",
]  # fmt: skip

NO_FLOOR: Final = (0, 0)
SKEW: Final = 5  # seconds two synchronised clocks may differ
MAX_PROOFS: Final = 16 * 1024  # entries proved absent, and wanted, that are remembered
_HINT_STALE: Final = "check that the master is running and reachable, and both clocks"


class Revocations:
    """The newest list of one authority, and the last confirmation that it is the newest."""

    def __init__(
        self, anchor_key: ec.EllipticCurvePublicKey, floor: tuple[int, int] = NO_FLOOR
    ) -> None:
        """Start without a list; nothing below `floor` = (epoch, seq) will be accepted."""
        self._key = anchor_key
        self._floor = floor
        self._list: RevocationList | RevocationTree | None = None
        self._data = b""
        self._entries: frozenset[bytes] = frozenset()
        self._received = 0
        self._complete = True  # False: `_entries` are those that are known of a tree
        self._absent: set[bytes] = set()
        self._unproved: dict[bytes, None] = {}
        self._confirmed: Timestamp | None = None
        self._relied_until = 0  # until when on a confirmation that is doubted now

    @property
    def floor(self) -> tuple[int, int]:
        """The (epoch, seq) below which no list is accepted: what must survive a restart."""
        return self._floor

    @property
    def data(self) -> bytes:
        """The signed list held, as received; empty if there is none."""
        return self._data

    @property
    def current(self) -> RevocationList | RevocationTree | None:
        """The list or tree held, if any."""
        return self._list

    @property
    def entries(self) -> frozenset[bytes]:
        """Everything known to be revoked, whether or not the knowledge is fresh."""
        return self._entries

    @property
    def fresh_until(self) -> int:
        """The last second at which `check` may say yes, or might have; 0 if there is none."""
        if self._list is None or self._confirmed is None:
            return self._relied_until
        return min(self._confirmed.issued + self._confirmed.max_age, self._list.expires - 1)

    def status_valid_until(self, entry: bytes) -> int:
        """As `fresh_until`, for one entry: for the proof of one there is as long as for news."""
        if self._complete or entry in self._absent:
            return self.fresh_until
        return min(self.fresh_until, self._received + MAX_AGE)

    @property
    def unproved(self) -> list[bytes]:
        """Entries of a tree that were asked about and are waiting for a proof."""
        return list(self._unproved)

    def add_proof(self, entry: bytes, proof: bytes) -> None:
        """Take the proof that `entry` is in the tree held, or is not.

        Raises:
            RevocationRefused: it shows neither.
        """
        if not isinstance(self._list, RevocationTree):
            return  # a list has come meanwhile, which says it all
        revoked = is_revoked(self._list, check_entry(entry), proof)
        self._unproved.pop(entry, None)
        if revoked:
            self._entries |= {entry}
            return
        if len(self._absent) >= MAX_PROOFS:
            self._absent.clear()
        self._absent.add(entry)

    def set_entries(self, listing: TreeEntries) -> None:
        """Take all entries of the tree held: nothing needs a proof any more.

        Raises:
            RevocationRefused: these are not its entries, or no tree is held.
        """
        if not isinstance(self._list, RevocationTree):
            raise RevocationRefused("entries of a tree, and none is held")
        listing.check(self._list)
        self._entries, self._complete = listing.entries, True

    def update(
        self, data: bytes, now: int, persist: Callable[[bytes], None] | None = None
    ) -> frozenset[bytes]:
        """Take a signed list or tree; return the entries it adds, whose connections are to be cut.

        Its age is not judged: a clock that lags must not keep revocations out. `persist(data)` is
        called after all checks and before the list takes effect; if it raises, nothing changes. A
        list that has expired is taken too: what it revokes stays revoked, and `check` refuses
        everything else. A new list needs a new confirmation. With a tree, what was known to be
        revoked stays so.

        Raises:
            RevocationRefused: not a list signed by the authority.
            RollbackRefused: older than one seen, or different under the same number.
        """
        revocations = open_statement(data, self._key)
        self._check_number(revocations)
        if data == self._data:
            return frozenset()
        if persist is not None:
            persist(data)
        self._complete = isinstance(revocations, RevocationList)
        entries = revocations.entries if isinstance(revocations, RevocationList) else self._entries
        added = entries - self._entries
        self._list, self._data, self._floor = revocations, data, revocations.number
        self._entries, self._received = entries, now
        self._confirmed, self._relied_until = None, 0
        self._absent, self._unproved = set(), {}
        return added

    def confirm(self, timestamp: Timestamp, now: int) -> None:
        """Take the master's word, opened with `open_timestamp`, that the list held is the newest.

        Raises:
            RevocationRefused: for another list.
            ClocksDisagree: too old, or from the future.
        """
        if self._list is None:
            raise RevocationRefused("a timestamp came before any revocation list", _HINT_STALE)
        if timestamp.seq != self._list.seq or timestamp.digest != digest(self._data):
            raise RevocationRefused(
                f"the timestamp is for another list than number {self._list.seq} held here",
                "fetch the newest list from the master",
            )
        if timestamp.max_age > MAX_AGE:
            raise RevocationRefused("the timestamp claims to be valid for too long")
        if timestamp.issued > now + SKEW:
            raise ClocksDisagree("the timestamp is from the future", "check both clocks")
        if timestamp.issued + timestamp.max_age < now:
            raise ClocksDisagree("the timestamp is too old", "check both clocks")
        if self._confirmed is None or not self._is_replay(self._confirmed, timestamp, now):
            self._confirmed = timestamp

    def expire_confirmation(self, until: int = 0) -> None:
        """Rely on the last confirmation no longer than `until`, and wait for a new one."""
        self._relied_until = min(self.fresh_until, until)
        self._confirmed = None

    def check(self, entry: bytes, now: int) -> None:
        """Return if `entry` (a grant id or key thumbprint) is known not to be revoked.

        Raises:
            Revoked: it is on the list, fresh or not.
            RevocationsStale: nobody can tell.
            RevocationRefused: `entry` is neither grant id nor thumbprint.
        """
        if check_entry(entry) in self.entries:
            raise Revoked(
                f"{entry.hex()} is revoked", "ask the authority's operator for the reason"
            )
        unproved = not self._complete and entry not in self._absent
        if unproved and len(self._unproved) < MAX_PROOFS:
            self._unproved[entry] = None
        self.check_fresh(now)
        if unproved:
            raise RevocationsStale(f"no proof has come yet that {entry.hex()} holds", _HINT_STALE)

    def check_fresh(self, now: int) -> None:
        """Return if the list held is confirmed and valid at `now`.

        Raises:
            RevocationsStale: no list, an expired list, no confirmation, or an outdated one.
        """
        if self._list is None:
            raise RevocationsStale("no revocation list has arrived yet", _HINT_STALE)
        if now >= self._list.expires:
            raise RevocationsStale(
                f"the revocation list expired {now - self._list.expires} s ago",
                "have the authority sign a new one: `rossec ca refresh`",
            )
        if self._confirmed is None:
            raise RevocationsStale(
                "the revocation list is not confirmed by the master", _HINT_STALE
            )
        if now > self.fresh_until:
            raise RevocationsStale(
                f"the last confirmation ran out {now - self.fresh_until} s ago", _HINT_STALE
            )
        if now < max(self._list.issued, self._confirmed.issued) - SKEW:
            raise RevocationsStale("the clock is behind the revocation list", "set the clock")

    def _check_number(self, new: RevocationList | RevocationTree) -> None:
        if new.number < self._floor:
            raise RollbackRefused(
                f"revocation list {_text(new.number)} is older than {_text(self._floor)}",
                "somebody is replaying an old list: find out who sent it",
            )
        if self._list is not None and new.number == self._list.number and new != self._list:
            raise RollbackRefused(
                f"there are two different revocation lists {_text(new.number)}",
                "the authority's database was restored or copied: begin a new epoch",
            )

    @staticmethod
    def _is_replay(held: Timestamp, new: Timestamp, now: int) -> bool:
        """A replayed older timestamp must not shorten the time; a corrected clock must heal."""
        return new.issued <= held.issued <= now + SKEW


def open_statement(
    data: bytes, ca_key: ec.EllipticCurvePublicKey
) -> RevocationList | RevocationTree:
    """Verify and read a list or a tree.

    Raises:
        RevocationRefused: not signed by the authority, malformed, or neither.
    """
    return open_tree(data, ca_key) if is_tree(data) else open_list(data, ca_key)


def _text(number: tuple[int, int]) -> str:
    return f"{number[0]}.{number[1]}"
