"""Whom a node trusts to say who somebody is: its own authority, and the listed foreign ones.

The trust domain in a leaf is a lookup key only: exactly one root is tried, and the whole
verification is that of the own domain. What a foreign root says counts for the names that the list
admits, and for nothing else; its wildcard tails are not honoured. The newest list is one immutable
value, replaced in one step: threads verify while a list arrives.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

from cryptography.hazmat.primitives.asymmetric import ec

from ca import svid
from ca.certificates import Identity, TrustAnchor
from ca.domains.aliases import alias_of
from ca.domains.lists import DomainList, ForeignDomain, open_domains
from ca.errors import CertificateRefused, DomainsRefused, NameRefused, NotAdmitted
from ca.keys.publickey import from_coordinates
from ca.patterns import covers

NO_FLOOR: Final = (0, 0)
_HINT: Final = "at this side's authority: rossec domain list, rossec domain accept CARD"


@dataclass(frozen=True)
class ListedDomain:
    """A foreign domain and its root, ready to verify with."""

    entry: ForeignDomain
    anchor: TrustAnchor

    def verify(self, chain: Sequence[bytes], now: int) -> Identity:
        """The identity of a node of this domain, under its alias.

        Raises:
            NotAdmitted: the trust in the domain has ended, or does not extend to this name.
            CertificateRefused: as `TrustAnchor.verify`.
        """
        entry = self.entry
        if now >= entry.until:
            raise NotAdmitted(f"the trust in domain {entry.label} has ended", _HINT)
        identity = self.anchor.verify(chain, now)
        if not any(covers(pattern, identity.name) for pattern in entry.admitted):
            raise NotAdmitted(f"{entry.label}:{identity.name} is not admitted here", _HINT)
        try:
            alias = alias_of(entry.label, identity.name)
        except NameRefused as error:
            raise NotAdmitted(f"a foreign node has no alias here: {error}") from error
        return replace(
            identity, name=alias, certified=identity.name, wildcard=False,
            not_after=min(identity.not_after, entry.until - 1), root=self.anchor.thumbprint,
        )  # fmt: skip


class _Snapshot(NamedTuple):
    """One list, as received and read."""

    data: bytes
    current: DomainList | None
    by_domain: dict[str, ListedDomain]
    by_label: dict[str, ListedDomain]
    masters: tuple[ec.EllipticCurvePublicKey, ...]


_NOTHING: Final = _Snapshot(b"", None, {}, {}, ())


class Anchors:
    """The own authority, and the newest list of foreign domains.

    Args:
        own: the own authority.
        floor: lists below this (epoch, seq) are refused.
    """

    def __init__(self, own: TrustAnchor, floor: tuple[int, int] = NO_FLOOR) -> None:
        self.own: Final = own
        self._floor = floor
        self._snapshot = _NOTHING

    @property
    def data(self) -> bytes:
        """The list as received; empty: there is none."""
        return self._snapshot.data

    @property
    def current(self) -> DomainList | None:
        """The list; None: there is none."""
        return self._snapshot.current

    @property
    def masters(self) -> tuple[ec.EllipticCurvePublicKey, ...]:
        """The keys of the own domain's masters, as far as listed."""
        return self._snapshot.masters

    def update(self, data: bytes, persist: Callable[[bytes], None] | None = None) -> frozenset[str]:
        """Take a list; returns the domains whose connections must end now: gone, or changed.

        `persist(data)` is called after all checks and before the list takes effect.

        Raises:
            DomainsRefused: not a list of the own authority, older than one seen, or a different
                one with the same number.
        """
        new, held = open_domains(data, self.own), self._snapshot
        if new.number < self._floor:
            raise DomainsRefused("an older list of domains than one seen before", "find the sender")
        if held.current is not None and new.number == held.current.number and data != held.data:
            raise DomainsRefused(
                "there are two different lists of domains with one number",
                "the authority's record was restored or copied: begin a new epoch",
            )
        if data == held.data:
            return frozenset()
        listed = [ListedDomain(each, each.anchor) for each in new.domains]
        masters = tuple(from_coordinates(key) for key in new.masters)
        if persist is not None:
            persist(data)
        self._floor = new.number
        self._snapshot = _Snapshot(
            data, new, {each.entry.domain: each for each in listed},
            {each.entry.label: each for each in listed}, masters,
        )  # fmt: skip
        return _ended(held.by_domain.values(), self._snapshot.by_domain)

    def verify(self, chain: Sequence[bytes], now: int) -> Identity:
        """The identity of a peer: of the own domain, or of a listed one under its alias.

        Raises:
            NotAdmitted: of a domain that is not listed, or a name that is not admitted.
            CertificateRefused: as `TrustAnchor.verify`.
        """
        held = self._snapshot
        if not held.by_domain or not chain:
            return self.own.verify(chain, now)
        domain = _claimed_domain(chain[0])
        if domain == self.own.domain or domain not in held.by_domain:
            return self.own.verify(chain, now)
        if held.current is None or now >= held.current.expires:
            raise NotAdmitted("the list of domains has expired", "rossec ca refresh")
        return held.by_domain[domain].verify(chain, now)

    def listed(self, label: str) -> ListedDomain | None:
        """The listed domain with this label; None: there is none."""
        return self._snapshot.by_label.get(label)

    def listed_domain(self, domain: str) -> ListedDomain | None:
        """The listed domain with this name; None: there is none."""
        return self._snapshot.by_domain.get(domain)

    @property
    def all_listed(self) -> tuple[ListedDomain, ...]:
        """Every listed domain, sorted by name."""
        return tuple(self._snapshot.by_domain.values())

    def ended(self, now: int) -> frozenset[str]:
        """The listed domains whose time is over: their connections must end."""
        return frozenset(
            name for name, each in self._snapshot.by_domain.items() if now >= each.entry.until
        )


def _ended(before: Iterable[ListedDomain], after: dict[str, ListedDomain]) -> frozenset[str]:
    """What is gone, and what is trusted under other terms than before."""
    return frozenset(
        each.entry.domain
        for each in before
        if each.entry.domain not in after or _terms(each) != _terms(after[each.entry.domain])
    )


def _terms(listed: ListedDomain) -> tuple[object, ...]:
    return listed.anchor.thumbprint, listed.entry.label, listed.entry.admitted


def _claimed_domain(leaf: bytes) -> str:
    """The trust domain a leaf claims; empty: none. Not trusted: it selects the root to try."""
    try:
        return svid.claimed_domain(svid.parse(leaf))
    except CertificateRefused:
        return ""
