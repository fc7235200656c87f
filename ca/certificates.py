"""Certificates: from bytes a stranger sent to the identity of a peer, or a refusal.

The form is the X.509-SVID of SPIFFE with every freedom removed: P-256 and SHA-256 only, exactly one
URI name, no authority, one key usage, issued by the one trust anchor or by one intermediate of it.
A chain is a sequence of one or two in this order: nothing is searched, because path building is
where verifiers break. The signature is checked before anything inside is believed; size before
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
from ca.errors import (
    CertificateExpired,
    CertificateNotYetValid,
    CertificateRefused,
    ForeignCertificate,
    NameRefused,
)
from ca.intermediates import Intermediate, read_intermediate
from ca.keys.publickey import thumbprint
from ca.names import check_wildcard, covers, parse_spiffe_id
from ca.requests import MAX_REQUEST, IdentityRequest, build_request, check_request
from ca.svid import MAX_CERTIFICATE

__all__ = [
    "MAX_CERTIFICATE", "MAX_REQUEST", "Identity", "IdentityRequest", "TrustAnchor",
    "build_request", "check_request", "from_pem", "to_pem",
]  # fmt: skip

_MAX_PEM: Final = 16 * 1024


@dataclass(frozen=True)
class Identity:
    """Who a verified certificate says its holder is. Times are inclusive, in seconds.

    `thumbprint` names the key (32 bytes, RFC 9679), `certificate` is the DER as received, `issuers`
    are the thumbprints of the intermediates it hangs on: when one is revoked, so is this identity.
    `not_after` is the end of the whole chain below the anchor.
    Grants and rules are for `name`; with `wildcard` it also stands for anonymous nodes (`covers`).
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

    def covers(self, name: str) -> bool:
        """Whether the holder may go by `name`: the certified one, or one with a certified tail."""
        return covers(self.name, name, wildcard=self.wildcard)

    @property
    def keys(self) -> tuple[bytes, ...]:
        """Every key whose revocation ends this identity: its own first."""
        return (self.thumbprint, *self.issuers)


@dataclass(frozen=True)
class TrustAnchor:
    """The one authority a node trusts. Build it with `load`; its key is parsed only once."""

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
        """Return the anchor in `der`, a self-signed root certificate. Its time is not judged here.

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
            ForeignCertificate: signed by somebody else.
            CertificateExpired, CertificateNotYetValid: one of them or the authority's, at `now`.
            CertificateRefused: anything else that is wrong; the message says what.
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
        _check_time("authority's certificate", self.not_before, self.not_after, now)
        _check_time(f"certificate of {identity.name}", identity.not_before, identity.not_after, now)
        if issuer is self:
            return identity
        end = min(identity.not_after, issuer.not_after)
        return replace(identity, issuers=(issuer.thumbprint,), not_after=end)

    def read_intermediate(self, der: bytes) -> Intermediate:
        """Return the intermediate in `der`. Its time is not judged here.

        Raises:
            CertificateRefused: as `verify`, or this authority may have none.
        """
        if self.path_length == 0:
            raise CertificateRefused(
                "this authority may have no intermediates", "its root is of an older form"
            )
        certificate = svid.parse(der)
        if not svid.is_signed_by(certificate, self.subject, self.public_key):
            raise self._foreign("intermediate")
        return read_intermediate(certificate, der, self.domain)

    def check_intermediate(self, der: bytes, now: int) -> Intermediate:
        """Return the intermediate in `der`, if it is valid at `now`.

        Raises:
            CertificateExpired, CertificateNotYetValid: it is not.
            CertificateRefused: as `read_intermediate`.
        """
        found = self.read_intermediate(der)
        _check_time("intermediate's certificate", found.not_before, found.not_after, now)
        return found

    def _foreign(self, what: str) -> ForeignCertificate:
        return ForeignCertificate(
            f"the {what} is not signed by the authority of trust domain {self.domain!r}",
            "enroll the node with this authority, or use the ca.pem that fits",
        )

    def _identity(self, der: bytes, issuer: "TrustAnchor | Intermediate") -> Identity:
        """What a leaf says; its signature is verified each time, before it is believed."""
        known = _cache.get((issuer.certificate, der))
        if known is not None and known.signed.verifies(issuer.public_key):
            return known.identity
        certificate = svid.parse(der)
        signed = svid.certificate_signature(certificate, issuer.subject)
        if signed is None or not signed.verifies(issuer.public_key):
            raise self._foreign("certificate")
        identity = _read(self.domain, certificate, der)
        _cache[issuer.certificate, der] = _CachedLeaf(signed, identity)
        if len(_cache) > _CACHE_SIZE:
            _cache.popitem(last=False)
        return identity


class _CachedLeaf(NamedTuple):
    """The parts of a leaf's DER."""

    signed: svid.CertificateSignature
    identity: Identity


# By the DER of the issuer and of the leaf. Peers come back for every topic, and taking their
# certificates apart is a pure function of the bytes, so its result is kept of those that verified.
# What is never kept is a verdict: the signature is verified and the times are compared each time.
_cache: Final[OrderedDict[tuple[bytes, bytes], _CachedLeaf]] = OrderedDict()
_CACHE_SIZE: Final = 256


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
        if wildcard:
            check_wildcard(name)
    except NameRefused as error:
        raise CertificateRefused(f"the certificate's name is none: {error}") from error
    if domain != expected:
        raise CertificateRefused(
            f"the certificate is for trust domain {domain!r}, not {expected!r}"
        )
    return name


def to_pem(*certificates: bytes) -> bytes:
    """Return DER certificates as one PEM bundle.

    Raises:
        CertificateRefused: one of them is no certificate.
    """
    return b"".join(svid.parse(der).public_bytes(Encoding.PEM) for der in certificates)


def from_pem(data: bytes) -> tuple[bytes, ...]:
    """Return the DER certificates of a PEM bundle, in its order; at least one.

    Raises:
        CertificateRefused: too large, or no PEM certificates.
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


def _check_time(what: str, start: int, end: int, now: int) -> None:
    if now < start:
        raise CertificateNotYetValid(
            f"the {what} becomes valid in {start - now} s", "check this computer's clock"
        )
    if now > end:
        raise CertificateExpired(
            f"the {what} expired {now - end} s ago", "sign and install a new certificate"
        )
