"""The list of foreign domains: who else exists, signed by the own authority's root.

Ordered, kept and delivered as the revocation list: (epoch, seq), the higher one wins, an older one
is refused. It also names the keys of the own domain's masters, whose tickets count
(docs/spec/domains.md section 2). One set of domains has one encoding.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, Final, NamedTuple, Self

from cryptography.hazmat.primitives.asymmetric import ec

from ca.certificates import TrustAnchor
from ca.cose import Profile
from ca.domains.aliases import check_label
from ca.encoding import Value, decode, encode
from ca.errors import CAError, DomainsRefused, EncodingError, SignatureError
from ca.keys.publickey import from_coordinates, to_coordinates
from ca.keys.signer import Signer
from ca.names import check_domain
from ca.patterns import check_pattern

DOMAINS: Final = Profile("rossec-domains+cwt")
MAX_LIST: Final = 64 * 1024
MAX_DOMAINS: Final = 64
MAX_MASTERS: Final = 64
MAX_RULES: Final = 64  # patterns of one domain, of each kind
LEAST_FRESH, MOST_FRESH = 30, 7 * 86400
ALL_RIGHTS: Final = 255  # bits, docs/spec/grant.md section 2

_EXP, _IAT, _EPOCH, _SEQ, _DOMAINS, _MASTERS = 4, 6, -70001, -70002, -70031, -70036
_INT_LIMIT: Final = 1 << 53

NameRights = tuple[str, int]
"""A pattern of names, and the bits of the rights on them."""


@dataclass(frozen=True)
class ForeignDomain:
    """One foreign domain, as far as it is trusted.

    Args:
        domain: its trust domain.
        label: what it is called here.
        root: its root certificate, DER.
        admitted: patterns of the names of its nodes that may connect; at least one.
        fresh: how old the last word on its revocations may be, seconds.
        until: when this trust ends.
        exported: what its masters are shown, and for which rights; None: whatever grants allow.
        imported: what is taken into the own graph; None: everything that is shown.
    """

    domain: str
    label: str
    root: bytes
    admitted: tuple[str, ...]
    fresh: int
    until: int
    exported: tuple[NameRights, ...] | None = None
    imported: tuple[NameRights, ...] | None = None

    def __post_init__(self) -> None:
        check_domain(self.domain)
        check_label(self.label)
        if not 1 <= len(self.admitted) <= MAX_RULES:
            raise DomainsRefused(f"domain {self.domain} admits no name, or too many patterns")
        for pattern in self.admitted:
            check_pattern(pattern)
        for rules in (self.exported, self.imported):
            _check_rules(rules or ())
        whole = type(self.fresh) is int and type(self.until) is int
        times = LEAST_FRESH <= self.fresh <= MOST_FRESH and 0 < self.until < _INT_LIMIT
        if not (whole and times):
            raise DomainsRefused(
                f"the times of domain {self.domain} are out of range", "30 seconds to 7 days"
            )
        if self.anchor.domain != self.domain:
            raise DomainsRefused(
                f"the root of domain {self.domain} is that of {self.anchor.domain}"
            )

    @cached_property
    def anchor(self) -> TrustAnchor:
        """Its root, parsed once."""
        return TrustAnchor.load(self.root)

    @property
    def terms(self) -> bytes:
        """The one encoding of all this, as in the list."""
        return encode(_claims(self))

    @classmethod
    def from_terms(cls, data: bytes) -> Self:
        """Read what `terms` wrote.

        Raises:
            EncodingError: not strict deterministic CBOR.
            CAError: not a domain as a list may have it.
        """
        return cls(*_domain(decode(data, limit=MAX_LIST)))


@dataclass(frozen=True)
class DomainList:
    """All foreign domains, sorted by name, and the own masters.

    Args:
        epoch, seq: the order of lists.
        issued, expires: seconds; an expired list admits nobody and cuts nobody.
        domains: at most 64.
        masters: the keys of the own domain's masters, as x and y (64 octets), sorted.
    """

    epoch: int
    seq: int
    issued: int
    expires: int
    domains: tuple[ForeignDomain, ...] = ()
    masters: tuple[bytes, ...] = ()

    def __post_init__(self) -> None:
        numbers = (self.epoch, self.seq, self.issued, self.expires)
        if not all(type(number) is int and 0 <= number < _INT_LIMIT for number in numbers):
            raise DomainsRefused("a number of the list of domains is out of range")
        if self.expires <= self.issued:
            raise DomainsRefused("a list of domains that is never valid")
        if len(self.domains) > MAX_DOMAINS or len(self.masters) > MAX_MASTERS:
            raise DomainsRefused("a list of too many domains or masters")
        _check_sorted([each.domain for each in self.domains])
        _check_sorted(list(self.masters))
        roots = [each.anchor.thumbprint for each in self.domains]
        for distinct in ([each.label for each in self.domains], roots):
            if len(set(distinct)) != len(distinct):
                raise DomainsRefused("two domains of the list share a label or a root key")
        for key in self.masters:
            from_coordinates(key)

    @property
    def number(self) -> tuple[int, int]:
        """The order of lists: (epoch, seq)."""
        return self.epoch, self.seq


def sign_domains(signer: Signer, domains: DomainList, own_domain: str) -> bytes:
    """Sign `domains` with the root key of `own_domain`.

    Raises:
        DomainsRefused: what `open_domains` would refuse.
    """
    _check_own(domains, own_domain, to_coordinates(signer.public_key))
    data = DOMAINS.sign(
        signer,
        {
            _EXP: domains.expires,
            _IAT: domains.issued,
            _EPOCH: domains.epoch,
            _SEQ: domains.seq,
            _DOMAINS: [_claims(each) for each in domains.domains],
            **({_MASTERS: [*domains.masters]} if domains.masters else {}),
        },
    )
    if len(data) > MAX_LIST:
        raise DomainsRefused(f"a list of domains of {len(data)} bytes, at most {MAX_LIST}")
    return data


def open_domains(data: bytes, own: TrustAnchor) -> DomainList:
    """Verify and read a list of the own authority; its age is not checked here.

    Raises:
        DomainsRefused: not signed by the root, malformed, or not a valid list.
    """
    domains = verify_domains(data, own.public_key)
    _check_own(domains, own.domain, to_coordinates(own.public_key))
    return domains


def verify_domains(data: bytes, key: ec.EllipticCurvePublicKey) -> DomainList:
    """As `open_domains`, for a list that may name the domain whose root key `key` is.

    Raises:
        DomainsRefused: not signed by `key`, malformed, or not a valid list.
    """
    try:
        return _read(DOMAINS.open(data, key, limit=MAX_LIST))
    except (SignatureError, EncodingError) as error:
        raise DomainsRefused(f"not a list of domains of this authority: {error}") from None
    except DomainsRefused:
        raise
    except CAError as error:
        raise DomainsRefused(f"in the list of domains: {error}", error.hint) from error


def _check_own(domains: DomainList, own_domain: str, own_key: bytes) -> None:
    for each in domains.domains:
        if each.domain == own_domain:
            raise DomainsRefused(
                "the list of foreign domains names the own one", "rossec domain list"
            )
        if to_coordinates(each.anchor.public_key) == own_key:
            raise DomainsRefused(f"the root of {each.domain} is this authority's own key")


def _claims(domain: ForeignDomain) -> Value:
    claims: dict[int | str, Value] = {
        1: domain.domain, 2: domain.label, 3: domain.root, 4: [*domain.admitted],
        5: domain.fresh, 6: domain.until,
    }  # fmt: skip
    for key, rules in ((8, domain.exported), (9, domain.imported)):
        if rules is not None:
            claims[key] = [[pattern, rights] for pattern, rights in rules]
    return claims


def _read(payload: Value) -> DomainList:
    match payload:
        case {
            4: int() as exp, 6: int() as iat, -70001: int() as epoch, -70002: int() as seq,
            -70031: list() as items, **rest,
        } if rest.keys() <= {_MASTERS}:  # fmt: skip
            masters = rest.get(_MASTERS, [])
        case _:
            raise DomainsRefused("the list of domains has missing or unknown fields")
    if not isinstance(masters, list) or (_MASTERS in rest and not masters):
        raise DomainsRefused("the masters of the list of domains are not a list of keys")
    if len(items) > MAX_DOMAINS or len(masters) > MAX_MASTERS:
        raise DomainsRefused("a list of too many domains or masters")
    keys = tuple(key for key in masters if isinstance(key, bytes))
    if len(keys) != len(masters):
        raise DomainsRefused("the masters of the list of domains are not a list of keys")
    domains = tuple(ForeignDomain(*_domain(item)) for item in items)
    return DomainList(epoch, seq, iat, exp, domains, keys)


class _Terms(NamedTuple):
    """The fields of a `ForeignDomain`, in its order."""

    domain: str
    label: str
    root: bytes
    admitted: tuple[str, ...]
    fresh: int
    until: int
    exported: tuple[NameRights, ...] | None
    imported: tuple[NameRights, ...] | None


def _domain(item: Value) -> _Terms:
    match item:
        case {
            1: str() as domain, 2: str() as label, 3: bytes() as root, 4: list() as admitted,
            5: int() as fresh, 6: int() as until, **rest,
        } if rest.keys() <= {8, 9}:  # fmt: skip
            patterns = tuple(each for each in admitted if isinstance(each, str))
            if len(patterns) != len(admitted):
                raise DomainsRefused("an admitted name of a domain is not text")
            return _Terms(
                domain, label, root, patterns, fresh, until,
                _rules(rest[8]) if 8 in rest else None, _rules(rest[9]) if 9 in rest else None,
            )  # fmt: skip
        case _:
            raise DomainsRefused("a domain of the list has missing or unknown fields")


def _rules(value: Any) -> tuple[NameRights, ...]:
    rules: list[NameRights] = []
    for item in value if isinstance(value, list) else [value]:
        match item:
            case [str() as pattern, int() as rights]:
                rules.append((pattern, rights))
            case _:
                raise DomainsRefused("an export or import of a domain is not [pattern, rights]")
    return tuple(rules)


def _check_rules(rules: tuple[NameRights, ...]) -> None:
    if len(rules) > MAX_RULES:
        raise DomainsRefused(f"more than {MAX_RULES} exports or imports of one domain")
    for pattern, rights in rules:
        check_pattern(pattern)
        if type(rights) is not int or not 0 < rights <= ALL_RIGHTS:
            raise DomainsRefused(f"unknown or no right on {pattern}")


def _check_sorted(items: list[Any]) -> None:
    if any(first >= second for first, second in pairwise(items)):
        raise DomainsRefused("the list of domains is not sorted, or has an entry twice")
