"""What is revoked, and known to be: of the own domain, and of each listed foreign one.

A foreign domain's list is verified by its root's key, and confirmed by a timestamp of a master of
that domain, which any peer may hand over. It counts for the nodes and the grants of that domain
and for nothing else: a hospital cannot revoke what is not its own. The own list counts for every
key. Pure; a state lasts as long as the root it was made for. Whoever shares it between threads
locks it.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from typing import Final

from cryptography.hazmat.primitives.asymmetric import ec

from ca.certificates import Identity
from ca.domains.anchors import Anchors, ListedDomain
from ca.errors import NotAdmitted, RevocationRefused, RevocationsStale
from ca.keys.publickey import thumbprint
from ca.names import is_master_name
from ca.patterns import covers
from ca.revocation.state import Revocations, open_timestamp

MAX_DELEGATES: Final = 16  # masters of one foreign domain, the last ones seen
_HINT: Final = "at this side's authority: rossec domain list, rossec domain accept CARD"
_SILENT: Final = "does this side's master reach that domain's? rossec federation status"


@dataclass
class _Foreign:
    """One foreign domain: its root, its list, the keys of its masters by thumbprint."""

    root: bytes
    revocations: Revocations
    masters: dict[bytes, ec.EllipticCurvePublicKey] = field(default_factory=dict)


class Standing:
    """The revocations of the own domain and of the listed ones.

    Args:
        anchors: which domains are listed.
        own: the own authority's list.
    """

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
        except RevocationRefused:  # saved under an earlier root: nothing follows from it
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
        """Take a foreign list (empty: the one held) and its timestamp; returns what it adds.

        A valid list is kept even when the timestamp is not accepted. `persist(list)` is called
        after all checks of the list and before it takes effect.

        Args:
            chain: the certificates of the master that signed the timestamp, DER, the leaf first.

        Raises:
            NotAdmitted: the domain is not listed, or the chain is not that of a master of it.
            CertificateRefused: the chain is invalid under that domain's root.
            RevocationRefused: the list or the timestamp is; `RollbackRefused`, `ClocksDisagree`.
            Revoked: the master's key.
            RevocationsStale: no timestamp; or, of a tree, no proof yet for the master's key.
        """
        listed, held = self._listed(domain), self._held(domain)
        if held is None:
            raise _not_listed(domain)
        added: frozenset[bytes] = frozenset()
        if revocations:
            added = held.revocations.update(revocations, now, persist)
        if not timestamp:
            raise RevocationsStale(f"no word of {listed.entry.label}'s master", _SILENT)
        master = _master(listed, chain, now)
        self._check_master(held.revocations, master, now)
        held.revocations.confirm(open_timestamp(timestamp, master.public_key), now)
        held.masters.pop(master.thumbprint, None)
        held.masters[master.thumbprint] = master.public_key
        if len(held.masters) > MAX_DELEGATES:
            del held.masters[next(iter(held.masters))]
        return added

    def check(self, domain: str, entry: bytes, now: int) -> None:
        """Return if `entry` is known not to be revoked by the authority of `domain`.

        Raises:
            Revoked: it is.
            RevocationsStale: its status is unknown.
            NotAdmitted: the domain is not listed.
        """
        if domain == self.anchors.own.domain:
            self.own.check(entry, now)
            return
        held = self._held(domain)
        if held is None:
            raise _not_listed(domain)
        try:
            held.revocations.check(entry, now)
        except RevocationsStale as error:
            label = self._listed(domain).entry.label
            raise RevocationsStale(f"of domain {label}: {error}", _SILENT) from None

    def check_peer(self, peer: Identity, now: int) -> None:
        """Return if a new connection with `peer` is right, as far as its identity goes.

        All its keys are checked: stale data on the first must not hide that its intermediate is
        revoked. Those of a foreigner on the own list too, so that this side can refuse one at once.

        Raises:
            Revoked: one of its keys is revoked, by the own authority or its own one.
            NotAdmitted: the trust in its domain has ended, or does not extend to its name.
            RevocationsStale: this is not known.
        """
        checks: list[Callable[[bytes, int], None]] = [self.own.check]
        if peer.is_foreign:
            self.check_trust(peer, now)
            current = self.anchors.current
            if current is None or now >= current.expires:
                raise NotAdmitted("the list of domains has expired", "rossec ca refresh")
            checks.append(partial(self.check, peer.domain))
        stale: RevocationsStale | None = None
        for check in checks:
            for key in peer.keys:
                try:
                    check(key, now)
                except RevocationsStale as error:
                    stale = stale or error
        if stale is not None:
            raise stale

    def check_trust(self, peer: Identity, now: int) -> None:
        """Return if the newest list of domains lets a connection with `peer` stand.

        A list that has expired cuts nobody.

        Raises:
            NotAdmitted: its domain is gone, past its end, has another root or label, or the name
                is no longer admitted.
        """
        if not peer.is_foreign:
            return
        listed = self._listed(peer.domain)
        entry = listed.entry
        if now >= entry.until or listed.anchor.thumbprint != peer.root:
            raise NotAdmitted(f"the trust in domain {entry.label} has ended", _HINT)
        name, label = peer.certified_name, peer.name.split("/")[2]
        if label != entry.label or not any(covers(each, name) for each in entry.admitted):
            raise NotAdmitted(f"{entry.label}:{name} is not admitted here any more", _HINT)

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

    def delegates(self, domain: str) -> tuple[ec.EllipticCurvePublicKey, ...]:
        """The keys whose tickets renew grants of `domain`: its masters, unless revoked.

        Of the own domain those that the list of domains names; the caller adds its own master.
        """
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
        """The state of a listed domain, made or brought up to date with the list."""
        listed = self.anchors.listed_domain(domain)
        if listed is None:
            return None
        held = self._foreign.get(domain)
        if held is None or held.root != listed.anchor.thumbprint:
            held = _Foreign(listed.anchor.thumbprint, Revocations(listed.anchor.public_key))
            self._foreign[domain] = held
        held.revocations.fresh = listed.entry.fresh
        return held

    def _check_master(self, revocations: Revocations, master: Identity, now: int) -> None:
        """A revoked master confirms nothing; nor does one without a proof that it is not."""
        for key in master.keys:
            for each in (self.own, revocations):
                with suppress(RevocationsStale):  # the timestamp may end it
                    each.check(key, now)
                if not each.is_proved(key):
                    raise RevocationsStale("no proof yet for a foreign master's key", _SILENT)


def _master(listed: ListedDomain, chain: Sequence[bytes], now: int) -> Identity:
    """The identity of a master of a foreign domain; it need not be admitted as a peer."""
    identity = listed.anchor.verify(chain, now)
    if not is_master_name(identity.name) or identity.wildcard:
        raise NotAdmitted(
            f"{listed.entry.label}:{identity.name} is no master, and confirms no revocations"
        )
    return identity


def _not_listed(domain: str) -> NotAdmitted:
    return NotAdmitted(f"domain {domain!a} is not listed here", _HINT)
