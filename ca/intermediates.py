"""Intermediates: a host that signs nodes for a season, under a root that stays offline.

An intermediate is an authority of path length 0 for the same trust domain, signed by the root. Its
domain is its own SPIFFE ID, and every verifier here demands the same of its leaves. X.509's name
constraints say that too for URIs, but `cryptography`'s verifier refuses chains that have them.
What its host may do is said when it is made, as a certificate policy, and binds the host's own
tools (`ca.authority`): to renew identities that exist, or also to enroll new ones. It cannot bind a
thief: who has an intermediate's key signs any name, until the root revokes it.
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
from ca.requests import MAX_REQUEST, proven_key, requested_name
from ca.svid import PARSE_ERRORS, SCHEME, ends_with_whole_octets

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
    """Read an intermediate whose signature was verified; its time is not judged here.

    Raises:
        CertificateRefused: an authority of another form or another trust domain.
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
    """What an intermediate may do, as its certificate says it."""
    power = MAY_ENROLL if may_enroll else MAY_RENEW
    return x509.CertificatePolicies([x509.PolicyInformation(power, None)])


def _power(policies: frozenset[x509.ObjectIdentifier]) -> bool:
    if policies not in ({MAY_RENEW}, {MAY_ENROLL}):
        raise CertificateRefused(
            "the intermediate does not say whether it may renew or enroll", "make it anew"
        )
    return MAY_ENROLL in policies


def build_intermediate_request(signer: Signer, domain: str) -> bytes:
    """Return a CSR (DER) that asks for an intermediate of `domain` with the signer's key.

    Raises:
        NameRefused: `domain` is not one.
    """
    uri = x509.UniformResourceIdentifier(f"{SCHEME}{check_domain(domain)}")
    builder = x509.CertificateSigningRequestBuilder(x509.Name([])).add_extension(
        x509.SubjectAlternativeName([uri]), critical=True
    )
    return builder.sign(X509Signer(signer), hashes.SHA256()).public_bytes(Encoding.DER)


def check_intermediate_request(csr: bytes, domain: str) -> ec.EllipticCurvePublicKey:
    """Return the proven key of a request for an intermediate of `domain`.

    Raises:
        RequestRefused: malformed, unproven, or asking for anything else.
    """
    if len(csr) > MAX_REQUEST:
        raise RequestRefused(
            f"a request of {len(csr)} bytes where at most {MAX_REQUEST} are allowed", _HINT
        )
    try:
        request = x509.load_der_x509_csr(csr)
        if not ends_with_whole_octets(csr, request.signature):
            raise RequestRefused("the request's signature is not in whole octets", _HINT)
        key, asked = proven_key(request), requested_name(request)
    except PARSE_ERRORS as error:
        raise RequestRefused("this is not a certificate request", _HINT) from error
    if asked != (f"{SCHEME}{domain}", False):
        raise RequestRefused(f"this is no request for an intermediate of {domain!r}", _HINT)
    return key
