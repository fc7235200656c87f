"""Intermediates: authorities that sign nodes for some months, under a root that stays offline.

An intermediate is an authority of path length 0 for the same trust domain, signed by the root. Its
SPIFFE ID is the domain, and every verifier here requires the same domain of its leaves. X.509 name
constraints could say that for URIs, but `cryptography`'s verifier refuses chains that have them.
A certificate policy, set at issuance, tells what its host may do: renew existing identities, or
also enroll new ones. The host's own tools (`ca.authority`) enforce it. It does not bind an
attacker: the holder of an intermediate's key can sign any name until the root revokes it.
"""

from dataclasses import dataclass
from typing import Final

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding

from ca import svid
from ca.errors import CertificateRefused, RequestRefused
from ca.keys.publickey import thumbprint
from ca.keys.signer import Signer
from ca.keys.x509signer import X509Signer
from ca.names import check_domain
from ca.requests import read_request, request_builder
from ca.svid import SCHEME

# Private policies, from UUIDs (ITU-T X.667).
MAY_RENEW: Final = x509.ObjectIdentifier("2.25.283421307419275216482910536471209357741")
MAY_ENROLL: Final = x509.ObjectIdentifier("2.25.140372948105529641730282947561038846219")
_HINT: Final = "make it on the host with `rossec ca intermediate request`"


@dataclass(frozen=True)
class Intermediate:
    """A verified intermediate. Times are inclusive, in seconds."""

    public_key: ec.EllipticCurvePublicKey
    thumbprint: bytes
    not_before: int
    not_after: int
    certificate: bytes
    subject: x509.Name
    serial: int
    may_enroll: bool


def read_intermediate(certificate: x509.Certificate, der: bytes, domain: str) -> Intermediate:
    """Read an intermediate whose signature was verified; its validity is not checked here.

    Raises:
        CertificateRefused: another form, or another trust domain.
    """
    extensions = svid.extensions(certificate)
    svid.check_intermediate(extensions)
    found = svid.trust_domain(extensions)
    if found != domain:
        raise CertificateRefused(f"the intermediate is for trust domain {found!r}, not {domain!r}")
    key = svid.key_of(certificate)
    start, end = svid.validity(certificate)
    may_enroll = _power(svid.policies(extensions))
    subject = svid.subject(certificate)
    return Intermediate(
        key, thumbprint(key), start, end, der, subject, certificate.serial_number, may_enroll
    )


def policy(*, may_enroll: bool) -> x509.CertificatePolicies:
    """The certificate policy that says what an intermediate may do."""
    power = MAY_ENROLL if may_enroll else MAY_RENEW
    return x509.CertificatePolicies([x509.PolicyInformation(power, None)])


def _power(policies: frozenset[x509.ObjectIdentifier]) -> bool:
    if policies not in ({MAY_RENEW}, {MAY_ENROLL}):
        raise CertificateRefused(
            "the intermediate has no policy to renew or enroll", "make a new one"
        )
    return MAY_ENROLL in policies


def build_intermediate_request(signer: Signer, domain: str) -> bytes:
    """Return a CSR (DER) for an intermediate of `domain` with the signer's key.

    Raises:
        NameRefused: `domain` is not a trust domain.
    """
    builder = request_builder(f"{SCHEME}{check_domain(domain)}")
    return builder.sign(X509Signer(signer), hashes.SHA256()).public_bytes(Encoding.DER)


def check_intermediate_request(csr: bytes, domain: str) -> ec.EllipticCurvePublicKey:
    """Return the key of a request for an intermediate of `domain`; possession is proven.

    Raises:
        RequestRefused: malformed, without proof of possession, or for anything else.
    """
    key, *asked = read_request(csr, _HINT)
    if asked != [f"{SCHEME}{domain}", False]:
        raise RequestRefused(f"this is not a request for an intermediate of {domain!r}", _HINT)
    return key
