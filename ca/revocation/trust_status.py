"""The revocations this node knows of its own domain and of the listed ones, and whether they are fresh.

The state fails closed: without a list, without a confirmation, after its maximum age, after the
list's own expiry, or on a clock that was set back, `check` refuses. A foreign list counts for the
nodes and grants of that domain and for nothing else, the own one for every key. Clock and disk are
the caller's; whoever shares a state between threads locks it.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from typing import Final

from ca import certificates, errors, names
from ca.domains import ADMIT_HINT, Anchors, ListedDomain
from ca.keys.signing import PublicKey, thumbprint
from ca.revocation import lists

NO_FLOOR: Final = (0, 0)
SKEW: Final = 5  # seconds two synchronised clocks may differ
MAX_PROOFS: Final = 16 * 1024  # cached entries proved absent, and entries without a proof
NO_LIST_YET: Final = "no revocation list was received yet"
_STALE: Final = "check that the master is running and reachable, and both clocks"

MAX_DELEGATES: Final = 16  # masters of one foreign domain, the last ones seen
_SILENT: Final = "does this side's master reach that domain's? rossec federation status"


class Revocations:
    """The newest list of one authority, and the last confirmation that it is the newest."""

    def __init__(
        self, anchor_key: PublicKey, floor: tuple[int, int] = NO_FLOOR, fresh: int | None = None
    ) -> None:
        self._key = anchor_key
        self.floor = floor
        # How old a confirmation may be, seconds; None: what each one says (`max_age`). Another value is for
        # foreign domains: 30 s would end visits with every outage of the line.
        self.fresh = fresh
        self.current: lists.RevocationList | lists.RevocationTree | None = None
        self.data = b""  # as signed
        self.digest = lists.digest(b"")  # of `data`: computed once, and compared for each node that has it
        self.entries: frozenset[bytes] = frozenset()
        self._received = 0
        self._complete = True  # False: `_entries` are the known ones of a tree
        self._absent: set[bytes] = set()
        self._unproved: dict[bytes, None] = {}
        self._confirmed: lists.Timestamp | None = None
        self._relied_until = 0  # the end of a confirmation that was expired early

    @property
    def fresh_until(self) -> int:
        """The last second at which `check` may succeed; 0 if there is none."""
        if self.current is None or self._confirmed is None:
            return self._relied_until
        return min(self._end(self._confirmed), self.current.expires - 1)

    def status_valid_until(self, entry: bytes) -> int:
        """As `fresh_until`, for one entry: a proof may take as long as a confirmation."""
        if self._complete or entry in self._absent:
            return self.fresh_until
        return min(self.fresh_until, self._received + lists.MAX_AGE)

    def is_proved(self, entry: bytes) -> bool:
        return self._complete or entry in self._absent or entry in self.entries

    @property
    def unproved(self) -> list[bytes]:
        return list(self._unproved)

    def add_proof(self, entry: bytes, proof: bytes) -> None:
        if not isinstance(self.current, lists.RevocationTree):
            return  # replaced by a list meanwhile, which needs no proofs
        revoked = lists.is_revoked(self.current, lists.check_entry(entry), proof)
        self._unproved.pop(entry, None)
        if revoked:
            self.entries |= {entry}
            return
        if len(self._absent) >= MAX_PROOFS:
            self._absent.clear()
        self._absent.add(entry)

    def set_entries(self, tree_entries: lists.TreeEntries) -> None:
        if not isinstance(self.current, lists.RevocationTree):
            raise errors.RevocationRefused("entries of a tree, but there is no tree")
        tree_entries.check(self.current)
        self.entries, self._complete = tree_entries.entries, True

    def update(
        self, data: bytes, now: int, persist: Callable[[bytes], None] | None = None
    ) -> frozenset[bytes]:
        """Apply a signed list or tree; return the entries it adds, to close their connections."""
        # Its age is not checked: a slow clock must not block revocations. `persist(data)` is called after all
        # checks and before the list takes effect; if it raises, nothing changes. An expired list is applied
        # too: what it revokes stays revoked, and `check` refuses everything else. A new list needs a new
        # confirmation. With a tree, what was known to be revoked stays so.
        # 1. Verified, once: a list comes by as many connections as a node has programs, and again after each
        # reconnection. The same octets are the same list, and what is in force is never below the floor.
        if self.current is not None and data == self.data:
            return frozenset()
        # Not older than what was seen before: also over a restart, by the saved `floor`.
        revocations = open_statement(data, self._key)
        self.check_number(revocations)
        # 2. On the disk before it takes effect (CVE-2025-2888 in tough was that order reversed).
        if persist is not None:
            persist(data)
        # 3. In force. What is known to be revoked stays so: a tree says nothing of single entries.
        entries = revocations.entries if isinstance(revocations, lists.RevocationList) else self.entries
        added, digest = entries - self.entries, lists.digest(data)
        self._complete = isinstance(revocations, lists.RevocationList)
        self.entries, self._received, self.digest = entries, now, digest
        # Last: by `data` it counts as done, and is not done again.
        self.current, self.data, self.floor = revocations, data, revocations.number
        self._confirmed, self._relied_until = None, 0
        self._absent, self._unproved = set(), {}
        return added

    def confirm(self, timestamp: lists.Timestamp, now: int) -> None:
        """Apply a timestamp, opened with `open_timestamp`: the current list is the newest."""
        if self.current is None:
            raise errors.RevocationRefused("a timestamp came before any revocation list", _STALE)
        if timestamp.seq != self.current.seq or timestamp.digest != self.digest:
            raise errors.RevocationRefused(
                f"the timestamp is for another list than the current number {self.current.seq}",
                "fetch the newest list from the master",
            )
        if timestamp.max_age > lists.MAX_AGE:
            raise errors.RevocationRefused("the timestamp claims to be valid for too long")
        # From the future it would count for longer than its maximum age.
        if timestamp.issued > now + SKEW:
            raise errors.ClocksDisagree("the timestamp is from the future", "check both clocks")
        if self._end(timestamp) < now:
            raise errors.ClocksDisagree("the timestamp is too old", "check both clocks")
        # The newer one counts, unless it is from a future that a clock set back has made of it.
        if self._confirmed is None or not (timestamp.issued <= self._confirmed.issued <= now + SKEW):
            self._confirmed = timestamp

    def expire_confirmation(self, until: int = 0) -> None:
        self._relied_until = min(self.fresh_until, until)
        self._confirmed = None

    def check(self, entry: bytes, now: int) -> None:
        """Return if `entry` (a grant id or key thumbprint) is known not to be revoked."""
        # 1. Revoked is revoked, however old the list is.
        if lists.check_entry(entry) in self.entries:
            raise errors.Revoked(f"{entry.hex()} is revoked", "ask the authority's operator for the reason")
        # 2. With a tree, absence needs a proof: it is noted, so that the caller can ask the master for one.
        unproved = not self._complete and entry not in self._absent
        if unproved and len(self._unproved) < MAX_PROOFS:
            self._unproved[entry] = None
        self.check_fresh(now)
        if unproved:
            raise errors.RevocationsStale(f"no proof received yet that {entry.hex()} is not revoked", _STALE)

    def check_fresh(self, now: int) -> None:
        if self.current is None:
            raise errors.RevocationsStale(NO_LIST_YET, _STALE)
        if now >= self.current.expires:
            raise errors.RevocationsStale(
                f"the revocation list expired {now - self.current.expires} s ago",
                "have the authority sign a new one: `rossec ca refresh`",
            )
        if self._confirmed is None:
            raise errors.RevocationsStale("the revocation list is not confirmed by the master", _STALE)
        if now > self.fresh_until:
            raise errors.RevocationsStale(
                f"the last confirmation expired {now - self.fresh_until} s ago", _STALE
            )
        if now < max(self.current.issued, self._confirmed.issued) - SKEW:
            raise errors.RevocationsStale("the clock is behind the revocation list", "set the clock")

    def _end(self, timestamp: lists.Timestamp) -> int:
        return timestamp.issued + (timestamp.max_age if self.fresh is None else self.fresh)

    def check_number(self, new: lists.RevocationList | lists.RevocationTree) -> None:
        """Return if a list or tree may follow the current one, or is the same."""
        if new.number < self.floor:
            raise errors.RevocationRefused(
                f"revocation list {_text(new.number)} is older than {_text(self.floor)}",
                "an old list was replayed: find out which peer sent it",
            )
        # Two lists of one number: a copy of the authority's key or record signs, and no order is right.
        if self.current is not None and new.number == self.current.number and new != self.current:
            raise errors.RevocationRefused(
                f"there are two different revocation lists {_text(new.number)}",
                "the authority's database was restored or copied: begin a new epoch",
            )


def open_statement(data: bytes, ca_key: PublicKey) -> lists.RevocationList | lists.RevocationTree:
    return lists.open_tree(data, ca_key) if lists.is_tree(data) else lists.open_list(data, ca_key)


def _text(number: tuple[int, int]) -> str:
    return f"{number[0]}.{number[1]}"


@dataclass
class _Foreign:
    root: bytes
    revocations: Revocations
    masters: dict[bytes, PublicKey] = field(default_factory=dict)


class TrustStatus:
    """The revocations of the own domain and of those that `anchors` lists."""

    def __init__(self, anchors: Anchors, own: Revocations) -> None:
        self.anchors: Final = anchors
        self.own: Final = own
        self._foreign: dict[str, _Foreign] = {}

    def foreign(self, domain: str) -> Revocations | None:
        """What is known of a listed domain's revocations; None: it is not listed."""
        held = self._held(domain)
        return None if held is None else held.revocations

    def restore(self, domain: str, revocations: bytes, now: int) -> bool:
        """Take a saved list, not confirmed; returns whether it is of the domain's present root."""
        held = self._held(domain)
        if held is None:
            return False
        try:
            held.revocations.update(revocations, now)
        except errors.RevocationRefused:  # saved under an earlier root: nothing follows from it
            return False
        return True

    def take_foreign(
        self,
        domain: str,
        revocations: bytes,
        timestamp: bytes,
        chain: Sequence[bytes],
        now: int,
        persist: Callable[[bytes], None] | None = None,
    ) -> frozenset[bytes]:
        """Take a foreign list (empty: the one held) and its timestamp; returns what it adds."""
        # A valid list is kept even when the timestamp is not accepted. `persist(list)` is called after all
        # checks of the list and before it takes effect. `chain` are the certificates of the master that
        # signed the timestamp, DER, the leaf first.
        listed, held = self._listed(domain), self._held(domain)
        if held is None:
            raise _not_listed(domain)
        # 1. The list: what it revokes counts even when the timestamp is not accepted.
        added: frozenset[bytes] = frozenset()
        if revocations:
            added = held.revocations.update(revocations, now, persist)
        if not timestamp:
            raise errors.RevocationsStale(f"no word of {listed.entry.label}'s master", _SILENT)
        # 2. The master that signed the timestamp need not be admitted as a peer, but is that domain's.
        master = listed.anchor.verify(chain, now)
        if not names.is_master_name(master.name) or master.wildcard:
            raise errors.NotAdmitted(
                f"{listed.entry.label}:{master.name} is no master, and confirms no revocations"
            )
        # 3. Neither side has revoked it: a stolen master key must not confirm the list before its own end.
        for key in master.keys:
            for each in (self.own, held.revocations):
                with suppress(errors.RevocationsStale):  # the timestamp may end it
                    each.check(key, now)
                if not each.is_proved(key):
                    raise errors.RevocationsStale("no proof yet for a foreign master's key", _SILENT)
        held.revocations.confirm(lists.open_timestamp(timestamp, master.public_key), now)
        held.masters.pop(master.thumbprint, None)
        held.masters[master.thumbprint] = master.public_key
        if len(held.masters) > MAX_DELEGATES:
            del held.masters[next(iter(held.masters))]
        return added

    def check(self, domain: str, entry: bytes, now: int) -> None:
        if domain == self.anchors.own.domain:
            self.own.check(entry, now)
            return
        held = self._held(domain)
        if held is None:
            raise _not_listed(domain)
        try:
            held.revocations.check(entry, now)
        except errors.RevocationsStale as error:
            label = self._listed(domain).entry.label
            raise errors.RevocationsStale(f"of domain {label}: {error}", _SILENT) from None

    def check_peer(self, peer: certificates.Identity, now: int) -> None:
        """Return if a new connection with `peer` is right, as far as its identity goes."""
        # All its keys are checked: stale data on the first must not hide that its intermediate is revoked.
        # Those of a foreigner on the own list too, so that this side can refuse one at once.
        checks: list[Callable[[bytes, int], None]] = [self.own.check]
        if peer.is_foreign:
            self.check_trust(peer, now)
            current = self.anchors.current
            if current is None or now >= current.expires:
                raise errors.NotAdmitted("the list of domains has expired", "rossec ca refresh")
            checks.append(partial(self.check, peer.domain))
        stale: errors.RevocationsStale | None = None
        for check in checks:
            for key in peer.keys:
                try:
                    check(key, now)
                except errors.RevocationsStale as error:
                    stale = stale or error
        if stale is not None:
            raise stale

    def check_trust(self, peer: certificates.Identity, now: int) -> None:
        """Return if the newest list of domains lets a connection with `peer` stand."""
        # A list that has expired cuts nobody.
        if not peer.is_foreign:
            return
        listed = self._listed(peer.domain)
        entry = listed.entry
        if now >= entry.until or listed.anchor.thumbprint != peer.root:
            raise errors.NotAdmitted(f"the trust in domain {entry.label} has ended", ADMIT_HINT)
        name, label = peer.certified_name, peer.name.split("/")[2]
        if label != entry.label or not any(names.pattern_covers(each, name) for each in entry.admitted):
            raise errors.NotAdmitted(f"{entry.label}:{name} is not admitted here any more", ADMIT_HINT)

    def status_valid_until(self, domain: str, entry: bytes) -> int:
        """The last second at which `check` may succeed, now or before; 0: it never could."""
        if domain == self.anchors.own.domain:
            return self.own.status_valid_until(entry)
        held = self._held(domain)
        return 0 if held is None else held.revocations.status_valid_until(entry)

    def revoked(self, domain: str) -> frozenset[bytes]:
        """Everything known to be revoked by the authority of `domain`, fresh or not."""
        if domain == self.anchors.own.domain:
            return self.own.entries
        held = self._held(domain)
        return frozenset() if held is None else held.revocations.entries

    def delegates(self, domain: str) -> tuple[PublicKey, ...]:
        """The keys whose tickets renew grants of `domain`: its masters, unless revoked."""
        # Of the own domain those that the list of domains names; the caller adds its own master.
        if domain == self.anchors.own.domain:
            keys = self.anchors.masters
        else:
            held = self._held(domain)
            keys = () if held is None else tuple(held.masters.values())
        revoked = self.own.entries | self.revoked(domain)
        return tuple(key for key in keys if thumbprint(key) not in revoked)

    def expire_confirmations(self, until: int) -> None:
        """End every confirmation at `until`: the clock it was received by went back."""
        self.own.expire_confirmation(until)
        for held in self._foreign.values():
            held.revocations.expire_confirmation(until)

    def _listed(self, domain: str) -> ListedDomain:
        listed = self.anchors.listed_domain(domain)
        if listed is None:
            raise _not_listed(domain)
        return listed

    def _held(self, domain: str) -> _Foreign | None:
        listed = self.anchors.listed_domain(domain)
        if listed is None:
            return None
        held = self._foreign.get(domain)
        if held is None or held.root != listed.anchor.thumbprint:
            held = _Foreign(listed.anchor.thumbprint, Revocations(listed.anchor.public_key))
            self._foreign[domain] = held
        held.revocations.fresh = listed.entry.fresh
        return held


def _not_listed(domain: str) -> errors.NotAdmitted:
    return errors.NotAdmitted(f"domain {domain!a} is not listed here", ADMIT_HINT)
