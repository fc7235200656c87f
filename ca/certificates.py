"""Certificates: from bytes a stranger sent to the identity of a peer, or a refusal.

The form is the X.509-SVID of SPIFFE with every freedom removed: P-256 and SHA-256 only, issued
directly by the one trust anchor, exactly one URI name, no authority, one key usage. A chain is a
sequence of one: intermediates are refused until they are needed, because path building is where
verifiers break. The signature is checked before anything inside is believed; size before parsing.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Self

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
from ca.names import check_domain, check_wildcard, covers, parse_spiffe_id
from ca.publickey import thumbprint
from ca.requests import MAX_REQUEST, Request, build_request, check_request
from ca.svid import MAX_CERTIFICATE

__all__ = [
    "MAX_CERTIFICATE", "MAX_REQUEST", "Identity", "Request", "TrustAnchor",
    "build_request", "check_request", "from_pem", "to_pem",
]  # fmt: skip

_MAX_PEM: Final = 16 * 1024
_SCHEME: Final = "spiffe://"


@dataclass(frozen=True)
class Identity:
    """Who a verified certificate says its holder is. Times are inclusive, in seconds.

    `thumbprint` names the key (32 bytes, RFC 9679), `certificate` is the DER as received.
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

    def covers(self, name: str) -> bool:
        """Whether the holder may go by `name`: the certified one, or one with a certified tail."""
        return covers(self.name, name, wildcard=self.wildcard)


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
        domain = _domain_of(svid.only_uri(extensions))
        start, end = svid.validity(certificate)
        return cls(domain, key, thumbprint(key), start, end, der, subject)

    def verify(self, chain: Sequence[bytes], now: int) -> Identity:
        """Return the identity of the one certificate in `chain`, a sequence of DER.

        Raises:
            ForeignCertificate: signed by somebody else.
            CertificateExpired, CertificateNotYetValid: at `now`, this one or the authority's own.
            CertificateRefused: anything else that is wrong; the message says what.
        """
        if len(chain) != 1:
            raise CertificateRefused(
                f"a chain of {len(chain)} certificates where exactly one is expected",
                "send the node's certificate alone: the authority signs nodes directly",
            )
        certificate = svid.parse(chain[0])
        if not svid.is_signed_by(certificate, self.subject, self.public_key):
            raise ForeignCertificate(
                f"the certificate is not signed by the authority of trust domain {self.domain!r}",
                "enroll the node with this authority, or use the ca.pem that fits",
            )
        identity = self._identity(certificate, chain[0])
        _check_time("authority's certificate", self.not_before, self.not_after, now)
        _check_time(f"certificate of {identity.name}", identity.not_before, identity.not_after, now)
        return identity

    def _identity(self, certificate: x509.Certificate, der: bytes) -> Identity:
        return _read(self.domain, certificate, der)


@functools.lru_cache(maxsize=256)
def _read(domain: str, certificate: x509.Certificate, der: bytes) -> Identity:
    """What a certificate says; asked only about one whose signature has just been verified.

    A pure function of the bytes, so it is remembered: peers come back for every topic. What is
    never remembered is a verdict: signature, issuer and times are checked each time.
    """
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


def _domain_of(uri: str) -> str:
    try:
        if uri.startswith(_SCHEME):
            return check_domain(uri.removeprefix(_SCHEME))
    except NameRefused as error:
        raise CertificateRefused(f"the authority's name is none: {error}") from error
    raise CertificateRefused("the authority's name is not a SPIFFE trust domain")


def _check_time(what: str, start: int, end: int, now: int) -> None:
    if now < start:
        raise CertificateNotYetValid(
            f"the {what} becomes valid in {start - now} s", "check this computer's clock"
        )
    if now > end:
        raise CertificateExpired(
            f"the {what} expired {now - end} s ago", "sign and install a new certificate"
        )
