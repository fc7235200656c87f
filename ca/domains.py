"""Foreign trust domains: their bundles, the signed list of them, and whom a node trusts to name somebody.

The list is the own authority's, ordered as the revocation list: the higher (epoch, seq) wins, an
older one is refused. What a foreign root says counts for the names that the list admits and for
nothing else. docs/spec/domains.md
"""

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, Final, NamedTuple

from ca import errors, svid
from ca.certificates import Identity, TrustAnchor
from ca.encoding import Value, decode, encode, is_number
from ca.keys.signing import Profile, PublicKey, Signer, from_coordinates, thumbprint, to_coordinates
from ca.names import alias_of, check_domain, check_label, check_pattern, pattern_covers

TRUST_BUNDLE: Final = Profile("rossec-card+cwt")
TRUST_BUNDLE_LIFETIME: Final = 7 * 86400
MAX_TRUST_BUNDLE_LIFETIME: Final = 30 * 86400
MAX_TRUST_BUNDLE_NAMES: Final = 16
MAX_TRUST_BUNDLE_MASTERS: Final = 8
MAX_TRUST_BUNDLE: Final = svid.MAX_CERTIFICATE + 8 * 1024
SKEW: Final = 300  # seconds that another site's clock may be behind
_EXP, _IAT, _ROOT, _NAMES, _MASTERS = 4, 6, -70037, -70038, -70039
_URI: Final = re.compile(r"http://[A-Za-z0-9.:\[\]-]{1,255}/?", re.ASCII)
_HINT: Final = "ask for the file that `rossec domain bundle` wrote"

DOMAINS: Final = Profile("rossec-domains+cwt")
MAX_LIST: Final = 64 * 1024
MAX_DOMAINS: Final = 64
MAX_MASTERS: Final = 64
MAX_RULES: Final = 64  # patterns of one domain, of each kind
LEAST_FRESH, MOST_FRESH = 30, 7 * 86400
ALL_RIGHTS: Final = 255  # bits, docs/spec/grant.md section 2

_EPOCH, _SEQ, _DOMAINS, _OWN_MASTERS = -70001, -70002, -70031, -70036

NameRights = tuple[str, int]
"""A pattern of names, and the bits of the rights on them."""

NO_FLOOR: Final = (0, 0)
ADMIT_HINT: Final = "at this side's authority: rossec domain list, rossec domain accept TRUST_BUNDLE"


@dataclass(frozen=True)
class TrustBundle:
    """What a bundle says. Names and addresses are proposals: who accepts decides what is admitted."""

    root: bytes  # the root certificate of the domain, DER
    names: tuple[str, ...]  # patterns of the nodes for which admission is asked
    masters: tuple[str, ...]  # where its masters are, `http://host:port`
    issued: int
    expires: int

    def __post_init__(self) -> None:
        if not (is_number(self.issued) and is_number(self.expires) and self.issued < self.expires):
            raise errors.BundleRefused("a bundle that is never valid", _HINT)
        if self.expires - self.issued > MAX_TRUST_BUNDLE_LIFETIME:
            raise errors.BundleRefused("a bundle that is valid for more than 30 days", _HINT)
        if not 1 <= len(self.names) <= MAX_TRUST_BUNDLE_NAMES or len(self.masters) > MAX_TRUST_BUNDLE_MASTERS:
            raise errors.BundleRefused("a bundle with no names, or with too many names or masters", _HINT)
        for pattern in self.names:
            check_pattern(pattern)
        for uri in self.masters:
            if _URI.fullmatch(uri) is None:
                raise errors.BundleRefused(f"{uri[:300]!a} is not a master's address", "http://HOST:PORT")

    @cached_property
    def anchor(self) -> TrustAnchor:
        return TrustAnchor.load(self.root)


def sign_bundle(signer: Signer, bundle: TrustBundle) -> bytes:
    """The COSE_Sign1 of a bundle, by its own root key alone (docs/spec/domains.md)."""
    if thumbprint(signer.public_key) != bundle.anchor.thumbprint:
        raise errors.BundleRefused(
            "the bundle is not about this authority", "an intermediate signs no bundles"
        )
    names: list[Value] = [*bundle.names]
    claims: dict[int | str, Value] = {
        _EXP: bundle.expires,
        _IAT: bundle.issued,
        _ROOT: bundle.root,
        _NAMES: names,
    }
    if bundle.masters:
        claims[_MASTERS] = [*bundle.masters]
    return TRUST_BUNDLE.sign(signer, claims)


def open_bundle(data: bytes, now: int) -> TrustBundle:
    """The bundle in `data`, if it is signed by the root in it and valid at `now`, seconds."""
    # That proves that its maker has the key, and nothing about who that is: a person compares the
    # fingerprint over another way.
    try:
        bundle = _read_bundle(
            TRUST_BUNDLE.peek(data, limit=MAX_TRUST_BUNDLE)
        )  # the key to verify with is in it
        TRUST_BUNDLE.open(data, bundle.anchor.public_key, limit=MAX_TRUST_BUNDLE)
    except errors.BundleRefused:
        raise
    except (errors.SignatureError, errors.EncodingError) as error:
        raise errors.BundleRefused(f"this is not a domain's bundle: {error}", _HINT) from None
    except errors.CAError as error:
        raise errors.BundleRefused(f"in the bundle: {error}", _HINT) from error
    if now >= bundle.expires:
        raise errors.BundleRefused(f"the bundle expired {now - bundle.expires} s ago", "ask for a new one")
    if now < bundle.issued - SKEW:
        raise errors.BundleRefused("the bundle is from the future", "check the clocks of both computers")
    return bundle


def _read_bundle(payload: Value) -> TrustBundle:
    match payload:
        case {4: int() as exp, 6: int() as iat, -70037: bytes() as root, -70038: list() as names, **rest} if (
            rest.keys() <= {_MASTERS}
        ):
            masters = rest.get(_MASTERS, [])
        case _:
            raise errors.BundleRefused("the bundle has missing or unknown fields", _HINT)
    if not isinstance(masters, list) or (_MASTERS in rest and not masters):
        raise errors.BundleRefused("the masters of the bundle are not a list of addresses", _HINT)
    return TrustBundle(root, _texts(names), _texts(masters), iat, exp)


def _texts(items: list[Value]) -> tuple[str, ...]:
    texts = tuple(each for each in items if isinstance(each, str))
    if len(texts) != len(items) or len(items) > MAX_TRUST_BUNDLE_NAMES:
        raise errors.BundleRefused("the bundle has a name or an address that is not one", _HINT)
    return texts


@dataclass(frozen=True)
class ForeignDomain:
    """A domain as this side trusts it; terms that make no sense are `DomainsRefused`."""

    domain: str
    label: str  # what it is called here
    root: bytes  # its root certificate, DER
    admitted: tuple[str, ...]  # patterns of the names of its nodes that may connect
    fresh: int  # how old the last word on its revocations may be, seconds
    until: int  # when this trust ends
    exported: tuple[NameRights, ...] | None = None  # what its masters are shown; None: all that grants allow
    imported: tuple[NameRights, ...] | None = None  # what enters the own graph; None: all that is shown

    def __post_init__(self) -> None:
        check_domain(self.domain)
        check_label(self.label)
        if not 1 <= len(self.admitted) <= MAX_RULES:
            raise errors.DomainsRefused(f"domain {self.domain} admits no name, or too many patterns")
        for pattern in self.admitted:
            check_pattern(pattern)
        for rules in (self.exported or (), self.imported or ()):
            if len(rules) > MAX_RULES:
                raise errors.DomainsRefused(f"more than {MAX_RULES} exports or imports of one domain")
            for pattern, rights in rules:
                check_pattern(pattern)
                if type(rights) is not int or not 0 < rights <= ALL_RIGHTS:
                    raise errors.DomainsRefused(f"unknown or no right on {pattern}")
        whole = is_number(self.fresh) and is_number(self.until)
        if not (whole and LEAST_FRESH <= self.fresh <= MOST_FRESH and self.until > 0):
            raise errors.DomainsRefused(
                f"the times of domain {self.domain} are out of range", "30 seconds to 7 days"
            )
        if self.anchor.domain != self.domain:
            raise errors.DomainsRefused(f"the root of domain {self.domain} is that of {self.anchor.domain}")

    @cached_property
    def anchor(self) -> TrustAnchor:
        return TrustAnchor.load(self.root)

    @property
    def terms(self) -> bytes:
        return encode(_claims(self))

    @classmethod
    def from_terms(cls, data: bytes) -> "ForeignDomain":
        return _domain(decode(data, limit=MAX_LIST))


@dataclass(frozen=True)
class DomainList:
    """All foreign domains, sorted by name, and the own masters."""

    epoch: int
    seq: int
    issued: int
    expires: int  # an expired list admits nobody and cuts nobody
    domains: tuple[ForeignDomain, ...] = ()
    masters: tuple[bytes, ...] = ()  # keys whose tickets count, as x and y (64 octets), sorted

    def __post_init__(self) -> None:
        if not all(map(is_number, (self.epoch, self.seq, self.issued, self.expires))):
            raise errors.DomainsRefused("a number of the list of domains is out of range")
        if self.expires <= self.issued:
            raise errors.DomainsRefused("a list of domains that is never valid")
        if len(self.domains) > MAX_DOMAINS or len(self.masters) > MAX_MASTERS:
            raise errors.DomainsRefused("a list of too many domains or masters")
        _check_sorted([each.domain for each in self.domains])
        _check_sorted(list(self.masters))
        roots = [each.anchor.thumbprint for each in self.domains]
        for distinct in ([each.label for each in self.domains], roots):
            if len(set(distinct)) != len(distinct):
                raise errors.DomainsRefused("two domains of the list share a label or a root key")
        for key in self.masters:
            from_coordinates(key)

    @property
    def number(self) -> tuple[int, int]:
        return self.epoch, self.seq


def sign_domains(signer: Signer, domains: DomainList, own_domain: str) -> bytes:
    """The COSE_Sign1 of the list; `DomainsRefused` where it names `own_domain` or has over 64 KiB."""
    _check_own(domains, own_domain, to_coordinates(signer.public_key))
    data = DOMAINS.sign(
        signer,
        {
            _EXP: domains.expires,
            _IAT: domains.issued,
            _EPOCH: domains.epoch,
            _SEQ: domains.seq,
            _DOMAINS: [_claims(each) for each in domains.domains],
            **({_OWN_MASTERS: [*domains.masters]} if domains.masters else {}),
        },
    )
    if len(data) > MAX_LIST:
        raise errors.DomainsRefused(f"a list of domains of {len(data)} bytes, at most {MAX_LIST}")
    return data


def open_domains(data: bytes, own: TrustAnchor) -> DomainList:
    """Verify and read a list of the own authority; its age is not checked here."""
    domains = verify_domains(data, own.public_key)
    _check_own(domains, own.domain, to_coordinates(own.public_key))
    return domains


def verify_domains(data: bytes, key: PublicKey) -> DomainList:
    """As `open_domains`, for a list that may name the domain whose root key `key` is."""
    try:
        return _read_list(DOMAINS.open(data, key, limit=MAX_LIST))
    except (errors.SignatureError, errors.EncodingError) as error:
        raise errors.DomainsRefused(f"not a list of domains of this authority: {error}") from None
    except errors.DomainsRefused:
        raise
    except errors.CAError as error:
        raise errors.DomainsRefused(f"in the list of domains: {error}", error.hint) from error


def _check_own(domains: DomainList, own_domain: str, own_key: bytes) -> None:
    for each in domains.domains:
        if each.domain == own_domain:
            raise errors.DomainsRefused("the list of foreign domains names the own one", "rossec domain list")
        # Its nodes would be strangers by one name and own nodes by the other.
        if to_coordinates(each.anchor.public_key) == own_key:
            raise errors.DomainsRefused(f"the root of {each.domain} is this authority's own key")


def _claims(domain: ForeignDomain) -> Value:
    claims: dict[int | str, Value] = {
        1: domain.domain,
        2: domain.label,
        3: domain.root,
        4: [*domain.admitted],
        5: domain.fresh,
        6: domain.until,
    }
    for key, rules in ((8, domain.exported), (9, domain.imported)):
        if rules is not None:
            claims[key] = [[pattern, rights] for pattern, rights in rules]
    return claims


def _read_list(payload: Value) -> DomainList:
    match payload:
        case {
            4: int() as exp,
            6: int() as iat,
            -70001: int() as epoch,
            -70002: int() as seq,
            -70031: list() as items,
            **rest,
        } if rest.keys() <= {_OWN_MASTERS}:
            masters = rest.get(_OWN_MASTERS, [])
        case _:
            raise errors.DomainsRefused("the list of domains has missing or unknown fields")
    if not isinstance(masters, list) or (_OWN_MASTERS in rest and not masters):
        raise errors.DomainsRefused("the masters of the list of domains are not a list of keys")
    if len(items) > MAX_DOMAINS or len(masters) > MAX_MASTERS:
        raise errors.DomainsRefused("a list of too many domains or masters")
    keys = tuple(key for key in masters if isinstance(key, bytes))
    if len(keys) != len(masters):
        raise errors.DomainsRefused("the masters of the list of domains are not a list of keys")
    return DomainList(epoch, seq, iat, exp, tuple(map(_domain, items)), keys)


def _domain(item: Value) -> ForeignDomain:
    match item:
        case {
            1: str() as domain,
            2: str() as label,
            3: bytes() as root,
            4: list() as admitted,
            5: int() as fresh,
            6: int() as until,
            **rest,
        } if rest.keys() <= {8, 9}:
            patterns = tuple(each for each in admitted if isinstance(each, str))
            if len(patterns) != len(admitted):
                raise errors.DomainsRefused("an admitted name of a domain is not text")
            exported, imported = (_rules(rest[key]) if key in rest else None for key in (8, 9))
            return ForeignDomain(domain, label, root, patterns, fresh, until, exported, imported)
        case _:
            raise errors.DomainsRefused("a domain of the list has missing or unknown fields")


def _rules(value: Any) -> tuple[NameRights, ...]:
    rules: list[NameRights] = []
    for item in value if isinstance(value, list) else [value]:
        match item:
            case [str() as pattern, int() as rights]:
                rules.append((pattern, rights))
            case _:
                raise errors.DomainsRefused("an export or import of a domain is not [pattern, rights]")
    return tuple(rules)


def _check_sorted(items: list[Any]) -> None:
    if any(first >= second for first, second in pairwise(items)):
        raise errors.DomainsRefused("the list of domains is not sorted, or has an entry twice")


@dataclass(frozen=True)
class ListedDomain:
    """A domain of the list in force, with its root, parsed."""

    entry: ForeignDomain
    anchor: TrustAnchor

    def verify(self, chain: Sequence[bytes], now: int) -> Identity:
        entry = self.entry
        # 1. This side still trusts the domain; 2. the chain is of its root; 3. this side admits the name.
        if now >= entry.until:
            raise errors.NotAdmitted(f"the trust in domain {entry.label} has ended", ADMIT_HINT)
        identity = self.anchor.verify(chain, now)
        if not any(pattern_covers(pattern, identity.name) for pattern in entry.admitted):
            raise errors.NotAdmitted(f"{entry.label}:{identity.name} is not admitted here", ADMIT_HINT)
        try:
            alias = alias_of(entry.label, identity.name)
        except errors.NameRefused as error:
            raise errors.NotAdmitted(f"a foreign node has no alias here: {error}") from error
        # A tail of theirs is not honoured: it would admit names that nobody here has listed.
        return replace(
            identity,
            name=alias,
            certified=identity.name,
            wildcard=False,
            not_after=min(identity.not_after, entry.until - 1),
            root=self.anchor.thumbprint,
        )


class _Snapshot(NamedTuple):
    # Immutable, and replaced in one step: threads verify while a list arrives.
    data: bytes
    current: DomainList | None
    by_domain: dict[str, ListedDomain]
    by_label: dict[str, ListedDomain]
    masters: tuple[PublicKey, ...]


_NOTHING: Final = _Snapshot(b"", None, {}, {}, ())


class Anchors:
    """The own authority, and the newest list of foreign domains; none below `floor` is taken."""

    def __init__(self, own: TrustAnchor, floor: tuple[int, int] = NO_FLOOR) -> None:
        self.own: Final = own
        self._floor = floor
        self._snapshot = _NOTHING

    @property
    def data(self) -> bytes:
        return self._snapshot.data

    @property
    def current(self) -> DomainList | None:
        return self._snapshot.current

    @property
    def masters(self) -> tuple[PublicKey, ...]:
        return self._snapshot.masters

    def update(self, data: bytes, persist: Callable[[bytes], None] | None = None) -> frozenset[str]:
        """Take a list; returns the domains whose connections must end now: gone, or changed.

        `persist(data)` is called after all checks and before the list takes effect.
        """
        new, held = open_domains(data, self.own), self._snapshot
        if new.number < self._floor:
            raise errors.DomainsRefused("an older list of domains than one seen before", "find the sender")
        # The same number twice: two authorities have one key, or its record went back.
        if held.current is not None and new.number == held.current.number and data != held.data:
            raise errors.DomainsRefused(
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
        by_domain = {each.entry.domain: each for each in listed}
        by_label = {each.entry.label: each for each in listed}
        self._snapshot = _Snapshot(data, new, by_domain, by_label, masters)
        before = held.by_domain.items()
        return frozenset(name for name, each in before if _terms(each) != _terms(by_domain.get(name)))

    def verify(self, chain: Sequence[bytes], now: int) -> Identity:
        """The identity of a peer: of the own domain, or of a listed one under its alias."""
        held = self._snapshot
        if not held.by_domain or not chain:
            return self.own.verify(chain, now)
        # Its domain selects the one root that is tried, so no root can speak for another's domain.
        domain = self._domain_of(chain, held.by_domain.values())
        if domain == self.own.domain or domain not in held.by_domain:
            return self.own.verify(chain, now)
        if held.current is None or now >= held.current.expires:
            raise errors.NotAdmitted("the list of domains has expired", "rossec ca refresh")
        return held.by_domain[domain].verify(chain, now)

    def _domain_of(self, chain: Sequence[bytes], listed: Iterable[ListedDomain]) -> str:
        # What a root has verified is of its domain; of any other chain this is a claim, not trusted.
        for anchor in (self.own, *(each.anchor for each in listed)):
            if anchor.has_verified(chain):
                return anchor.domain
        try:
            return svid.claimed_domain(svid.parse(chain[0]))
        except errors.CertificateRefused:
            return ""

    def listed(self, label: str) -> ListedDomain | None:
        return self._snapshot.by_label.get(label)

    def listed_domain(self, domain: str) -> ListedDomain | None:
        return self._snapshot.by_domain.get(domain)

    @property
    def all_listed(self) -> tuple[ListedDomain, ...]:
        return tuple(self._snapshot.by_domain.values())

    def ended(self, now: int) -> frozenset[str]:
        """The listed domains whose time is over: their connections must end."""
        return frozenset(name for name, each in self._snapshot.by_domain.items() if now >= each.entry.until)


def _terms(listed: ListedDomain | None) -> tuple[object, ...]:
    return () if listed is None else (listed.anchor.thumbprint, listed.entry.label, listed.entry.admitted)
