"""The revocations this node knows, and whether they are fresh.

The state fails closed: without a list, without a confirmation, after its maximum age, after the
list's own expiry, or on a clock that was set back, `check` refuses. It only moves forward: a list
older than the newest ever seen is refused, also after a restart, because the caller persists the
list *before* it takes effect (CVE-2025-2888 in tough was that order reversed) and passes its number
as `floor`. Clock and disk are the caller's: `now` and `persist` are arguments.

Where the authority signed a tree instead of a list (`ca.revocation.tree`), each entry needs a
proof: until it is received the status is unknown, and the entry is in `unproved`.
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
MAX_PROOFS: Final = 16 * 1024  # cached entries proved absent, and entries without a proof
NO_LIST_YET: Final = "no revocation list was received yet"
_HINT_STALE: Final = "check that the master is running and reachable, and both clocks"


class Revocations:
    """The newest list of one authority, and the last confirmation that it is the newest.

    Attributes:
        fresh: how old a confirmation may be, seconds; None: what each one says (`max_age`). Another
            value is for foreign domains: 30 s would end visits with every outage of the line.
    """

    def __init__(
        self,
        anchor_key: ec.EllipticCurvePublicKey,
        floor: tuple[int, int] = NO_FLOOR,
        fresh: int | None = None,
    ) -> None:
        """Start without a list; lists below `floor` = (epoch, seq) are refused."""
        self._key = anchor_key
        self._floor = floor
        self.fresh = fresh
        self._list: RevocationList | RevocationTree | None = None
        self._data = b""
        self._entries: frozenset[bytes] = frozenset()
        self._received = 0
        self._complete = True  # False: `_entries` are the known ones of a tree
        self._absent: set[bytes] = set()
        self._unproved: dict[bytes, None] = {}
        self._confirmed: Timestamp | None = None
        self._relied_until = 0  # the end of a confirmation that was expired early

    @property
    def floor(self) -> tuple[int, int]:
        """The (epoch, seq) below which lists are refused; the caller persists it."""
        return self._floor

    @property
    def data(self) -> bytes:
        """The current signed list, as received; empty if there is none."""
        return self._data

    @property
    def current(self) -> RevocationList | RevocationTree | None:
        """The current list or tree, if any."""
        return self._list

    @property
    def entries(self) -> frozenset[bytes]:
        """Everything known to be revoked, fresh or not."""
        return self._entries

    @property
    def fresh_until(self) -> int:
        """The last second at which `check` may succeed; 0 if there is none."""
        if self._list is None or self._confirmed is None:
            return self._relied_until
        return min(self._end(self._confirmed), self._list.expires - 1)

    def status_valid_until(self, entry: bytes) -> int:
        """As `fresh_until`, for one entry: a proof may take as long as a confirmation."""
        if self._complete or entry in self._absent:
            return self.fresh_until
        return min(self.fresh_until, self._received + MAX_AGE)

    def is_proved(self, entry: bytes) -> bool:
        """Whether it is known if `entry` is revoked, confirmed or not."""
        return self._complete or entry in self._absent or entry in self._entries

    @property
    def unproved(self) -> list[bytes]:
        """Entries that were checked against a tree and have no proof yet."""
        return list(self._unproved)

    def add_proof(self, entry: bytes, proof: bytes) -> None:
        """Add the proof that `entry` is in the current tree, or is not.

        Raises:
            RevocationRefused: it shows neither.
        """
        if not isinstance(self._list, RevocationTree):
            return  # replaced by a list meanwhile, which needs no proofs
        revoked = is_revoked(self._list, check_entry(entry), proof)
        self._unproved.pop(entry, None)
        if revoked:
            self._entries |= {entry}
            return
        if len(self._absent) >= MAX_PROOFS:
            self._absent.clear()
        self._absent.add(entry)

    def set_entries(self, tree_entries: TreeEntries) -> None:
        """Set all entries of the current tree: no proofs are needed any more.

        Raises:
            RevocationRefused: these are not its entries, or there is no tree.
        """
        if not isinstance(self._list, RevocationTree):
            raise RevocationRefused("entries of a tree, but there is no tree")
        tree_entries.check(self._list)
        self._entries, self._complete = tree_entries.entries, True

    def update(
        self, data: bytes, now: int, persist: Callable[[bytes], None] | None = None
    ) -> frozenset[bytes]:
        """Apply a signed list or tree; return the entries it adds, to close their connections.

        Its age is not checked: a slow clock must not block revocations. `persist(data)` is called
        after all checks and before the list takes effect; if it raises, nothing changes. An expired
        list is applied too: what it revokes stays revoked, and `check` refuses everything else. A
        new list needs a new confirmation. With a tree, what was known to be revoked stays so.

        Raises:
            RevocationRefused: not a list signed by the authority.
            RollbackRefused: older than one seen, or different with the same number.
        """
        revocations = open_statement(data, self._key)
        self.check_number(revocations)
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
        """Apply a timestamp, opened with `open_timestamp`: the current list is the newest.

        Raises:
            RevocationRefused: for another list.
            ClocksDisagree: too old, or from the future.
        """
        if self._list is None:
            raise RevocationRefused("a timestamp came before any revocation list", _HINT_STALE)
        if timestamp.seq != self._list.seq or timestamp.digest != digest(self._data):
            raise RevocationRefused(
                f"the timestamp is for another list than the current number {self._list.seq}",
                "fetch the newest list from the master",
            )
        if timestamp.max_age > MAX_AGE:
            raise RevocationRefused("the timestamp claims to be valid for too long")
        if timestamp.issued > now + SKEW:
            raise ClocksDisagree("the timestamp is from the future", "check both clocks")
        if self._end(timestamp) < now:
            raise ClocksDisagree("the timestamp is too old", "check both clocks")
        if self._confirmed is None or not self._is_replay(self._confirmed, timestamp, now):
            self._confirmed = timestamp

    def expire_confirmation(self, until: int = 0) -> None:
        """End the last confirmation at `until` at the latest; a new one is needed."""
        self._relied_until = min(self.fresh_until, until)
        self._confirmed = None

    def check(self, entry: bytes, now: int) -> None:
        """Return if `entry` (a grant id or key thumbprint) is known not to be revoked.

        Raises:
            Revoked: it is on the list, fresh or not.
            RevocationsStale: its status is unknown.
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
            raise RevocationsStale(
                f"no proof received yet that {entry.hex()} is not revoked", _HINT_STALE
            )

    def check_fresh(self, now: int) -> None:
        """Return if the current list is confirmed and valid at `now`.

        Raises:
            RevocationsStale: no list, an expired list, no confirmation, or an outdated one.
        """
        if self._list is None:
            raise RevocationsStale(NO_LIST_YET, _HINT_STALE)
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
                f"the last confirmation expired {now - self.fresh_until} s ago", _HINT_STALE
            )
        if now < max(self._list.issued, self._confirmed.issued) - SKEW:
            raise RevocationsStale("the clock is behind the revocation list", "set the clock")

    def _end(self, timestamp: Timestamp) -> int:
        """The last second of a confirmation."""
        return timestamp.issued + (timestamp.max_age if self.fresh is None else self.fresh)

    def check_number(self, new: RevocationList | RevocationTree) -> None:
        """Return if a list or tree may follow the current one, or is the same.

        Raises:
            RollbackRefused: older than one seen, or different with the same number.
        """
        if new.number < self._floor:
            raise RollbackRefused(
                f"revocation list {_text(new.number)} is older than {_text(self._floor)}",
                "an old list was replayed: find out which peer sent it",
            )
        if self._list is not None and new.number == self._list.number and new != self._list:
            raise RollbackRefused(
                f"there are two different revocation lists {_text(new.number)}",
                "the authority's database was restored or copied: begin a new epoch",
            )

    @staticmethod
    def _is_replay(confirmed: Timestamp, new: Timestamp, now: int) -> bool:
        """Ignore an older timestamp, unless the confirmed one is now in the future."""
        return new.issued <= confirmed.issued <= now + SKEW


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
