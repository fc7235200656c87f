"""Certificates: from untrusted bytes to the verified identity of a peer, or a refusal.

The form is the X.509-SVID of SPIFFE without its options: P-256 and SHA-256 only, exactly one
URI name, not a CA, one key usage, issued by the trust anchor or by one intermediate of it.
A chain is one or two certificates in this order: there is no path building, where verifiers
have most of their bugs. The signature is checked before any content is trusted; size before
parsing.
"""

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple, Self

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding

from ca import svid
from ca.domains.aliases import refuse_alias
from ca.errors import (
    CertificateRefused,
    ForeignCertificate,
    NameRefused,
)
from ca.intermediates import Intermediate, read_intermediate
from ca.keys.publickey import thumbprint
from ca.names import check_wildcard, covers, parse_spiffe_id
from ca.requests import MAX_REQUEST, IdentityRequest, build_request, check_request
from ca.svid import MAX_CERTIFICATE
from ca.validity import check_time, way_back

__all__ = [
    "MAX_CERTIFICATE", "MAX_REQUEST", "Identity", "IdentityRequest", "TrustAnchor",
    "build_request", "check_request", "from_pem", "to_pem",
]  # fmt: skip

_MAX_PEM: Final = 16 * 1024


@dataclass(frozen=True)
class Identity:
    """The identity in a verified certificate. Times are inclusive, in seconds.

    `thumbprint` names the key (32 bytes, RFC 9679), `certificate` is the DER as received, `issuers`
    are the thumbprints of the intermediates in the chain: when one is revoked, so is this identity.
    `not_after` is the earliest one of the chain below the anchor.
    Grants and rules are for `name`; with `wildcard` it also covers anonymous nodes (`covers`).
    For a node of a foreign domain `name` is its alias here, `/remote/LABEL/...`, so that no
    comparison of names can take it for a node of the own domain; `certified` is then the name in
    its certificate, `root` the thumbprint of the foreign root (`ca.domains.anchors` sets them).
    """

    domain: str
    name: str
    public_key: ec.EllipticCurvePublicKey
    thumbprint: bytes
    not_before: int
    not_after: int
    serial: int
    certificate: bytes
    wildcard: bool = False
    issuers: tuple[bytes, ...] = ()
    certified: str = ""
    root: bytes = b""

    @property
    def certified_name(self) -> str:
        """The name in the certificate, by which the node calls itself."""
        return self.certified or self.name

    @property
    def is_foreign(self) -> bool:
        """Whether it is a node of a foreign domain."""
        return self.certified != ""

    def covers(self, name: str) -> bool:
        """Whether the holder may call itself `name`: as certified, or with a certified tail."""
        return covers(self.certified_name, name, wildcard=self.wildcard)

    def renews(self, other: "Identity") -> bool:
        """Whether it is `other` with a renewed certificate: nothing but times and issuer differ."""
        return all(
            getattr(self, each) == getattr(other, each)
            for each in ("domain", "name", "thumbprint", "wildcard", "certified", "root")
        )

    @property
    def keys(self) -> tuple[bytes, ...]:
        """Every key whose revocation revokes this identity: its own first."""
        return (self.thumbprint, *self.issuers)


@dataclass(frozen=True)
class TrustAnchor:
    """The root certificate a node trusts. Create it with `load`; its key is parsed only once."""

    domain: str
    public_key: ec.EllipticCurvePublicKey
    thumbprint: bytes
    not_before: int
    not_after: int
    certificate: bytes
    subject: x509.Name
    path_length: int | None = 0

    @classmethod
    def load(cls, der: bytes) -> Self:
        """Return the anchor in `der`, a self-signed root certificate. Its validity is not checked.

        Raises:
            CertificateRefused: not an authority's certificate of rossec's form.
        """
        certificate = svid.parse(der)
        key, subject = svid.key_of(certificate), svid.subject(certificate)
        if not svid.is_signed_by(certificate, subject, key):
            raise CertificateRefused(
                "the authority's certificate is not signed by itself",
                "take the ca.pem that `rossec ca init` wrote",
            )
        extensions = svid.extensions(certificate)
        svid.check_authority(extensions)
        domain, below = svid.trust_domain(extensions), svid.path_length(extensions)
        start, end = svid.validity(certificate)
        return cls(domain, key, thumbprint(key), start, end, der, subject, below)

    def verify(self, chain: Sequence[bytes], now: int) -> Identity:
        """Return the identity of `chain`: a leaf, or a leaf and its intermediate, as DER.

        Raises:
            ForeignCertificate: signed by another authority.
            CertificateExpired, CertificateNotYetValid: one of them, or the authority's.
            CertificateRefused: any other defect; the message says which.
        """
        match chain:
            case [leaf]:
                issuer: TrustAnchor | Intermediate = self
            case [leaf, second]:
                issuer = self.check_intermediate(second, now)
            case _:
                raise CertificateRefused(
                    f"a chain of {len(chain)} certificates where one or two are expected",
                    "send the node's certificate and its intermediate's, if it has one",
                )
        identity = self._identity(leaf, issuer)
        self.check_time(now)
        check_time(
            f"certificate of {identity.name}", identity.not_before, identity.not_after, now,
            f"where its authority is: {way_back(identity.name)}",
        )  # fmt: skip
        if issuer is self:
            return identity
        end = min(identity.not_after, issuer.not_after)
        return replace(identity, issuers=(issuer.thumbprint,), not_after=end)

    def read_intermediate(self, der: bytes) -> Intermediate:
        """Return the intermediate in `der`. Its validity is not checked here.

        Raises:
            CertificateRefused: as `verify`, or this authority may have none.
        """
        if self.path_length == 0:
            raise CertificateRefused(
                "this authority may have no intermediates", "its root is of an older form"
            )
        certificate = svid.parse(der)
        if not svid.is_signed_by(certificate, self.subject, self.public_key):
            raise self._foreign("intermediate", certificate)
        return read_intermediate(certificate, der, self.domain)

    def check_intermediate(self, der: bytes, now: int) -> Intermediate:
        """Return the intermediate in `der`, if it is valid at `now`.

        Raises:
            CertificateExpired, CertificateNotYetValid: it is not.
            CertificateRefused: as `read_intermediate`.
        """
        found = self.read_intermediate(der)
        check_time(
            "intermediate's certificate", found.not_before, found.not_after, now,
            "at the root: rossec ca intermediate sign FILE --may renew",
        )  # fmt: skip
        return found

    def check_time(self, now: int) -> None:
        """Return if the authority's own certificate is valid at `now`.

        Raises:
            CertificateExpired, CertificateNotYetValid: otherwise, which is a matter of clocks.
        """
        check_time(
            "authority's certificate", self.not_before, self.not_after, now,
            "the authority is ten years old, and must be replaced by a new one",
        )  # fmt: skip

    def _foreign(self, what: str, certificate: x509.Certificate) -> ForeignCertificate:
        """What it claims is no proof, but tells the operator which of two mistakes it is."""
        text = f"the {what} is not signed by the authority of trust domain {self.domain!r}"
        hint = "enroll the node with this authority, or use the ca.pem that fits"
        try:
            claimed = svid.claimed_domain(certificate)
        except CertificateRefused:
            claimed = ""
        if claimed == self.domain:
            return ForeignCertificate(
                f"{text}, but has its name", f"is there another authority of that name? {hint}"
            )
        return ForeignCertificate(f"{text}, but names {claimed!r}" if claimed else text, hint)

    def _identity(self, der: bytes, issuer: "TrustAnchor | Intermediate") -> Identity:
        """The identity in a leaf; its signature is verified each time, also of a cached one."""
        known = _cache.get((issuer.certificate, der))
        if known is not None and known.signed.verifies(issuer.public_key):
            return known.identity
        certificate = svid.parse(der)
        signed = svid.certificate_signature(certificate, issuer.subject)
        if signed is None or not signed.verifies(issuer.public_key):
            raise self._foreign("certificate", certificate)
        identity = _read(self.domain, certificate, der)
        _cache[issuer.certificate, der] = _CachedLeaf(signed, identity)
        if len(_cache) > CACHE_SIZE:
            _cache.popitem(last=False)
        return identity


class _CachedLeaf(NamedTuple):
    """The parsed parts of a leaf."""

    signed: svid.CertificateSignature
    identity: Identity


# By the DER of the issuer and of the leaf. Peers connect again for every topic, and parsing a
# certificate is a pure function of its bytes, so the result is cached once it has verified.
# The decision is never cached: signature and validity times are checked each time.
_cache: Final[OrderedDict[tuple[bytes, bytes], _CachedLeaf]] = OrderedDict()
CACHE_SIZE: Final = 256


def _read(domain: str, certificate: x509.Certificate, der: bytes) -> Identity:
    extensions = svid.extensions(certificate)
    svid.check_leaf(extensions)
    wildcard = svid.has_wildcard(extensions)
    name = _name(domain, svid.only_uri(extensions), wildcard=wildcard)
    key = svid.key_of(certificate)
    start, end = svid.validity(certificate)
    serial = certificate.serial_number
    return Identity(domain, name, key, thumbprint(key), start, end, serial, der, wildcard)


def _name(expected: str, uri: str, *, wildcard: bool) -> str:
    try:
        domain, name = parse_spiffe_id(uri)
        refuse_alias(name)
        if wildcard:
            check_wildcard(name)
    except NameRefused as error:
        raise CertificateRefused(f"the certificate's name is invalid: {error}") from error
    if domain != expected:
        raise CertificateRefused(
            f"the certificate is for trust domain {domain!r}, not {expected!r}"
        )
    return name


def to_pem(*certificates: bytes) -> bytes:
    """Return DER certificates as one PEM bundle.

    Raises:
        CertificateRefused: one of them is not a certificate.
    """
    return b"".join(svid.parse(der).public_bytes(Encoding.PEM) for der in certificates)


def from_pem(data: bytes) -> tuple[bytes, ...]:
    """Return the DER certificates of a PEM bundle, in its order; at least one.

    Raises:
        CertificateRefused: too large, or not PEM certificates.
    """
    if len(data) > _MAX_PEM:
        raise CertificateRefused(
            f"{len(data)} bytes of PEM where at most {_MAX_PEM} are allowed",
            "name the file with the node's certificate",
        )
    try:
        certificates = x509.load_pem_x509_certificates(data)
    except svid.PARSE_ERRORS as error:
        raise CertificateRefused(
            "this is not a PEM certificate", "name the file that `rossec ca sign` wrote"
        ) from error
    return tuple(certificate.public_bytes(Encoding.DER) for certificate in certificates)
