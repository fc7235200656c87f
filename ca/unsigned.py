"""A certificate that is to be signed: what it says is read before the key signs it. Pure.

A signer gets the TBSCertificate (RFC 5280 section 4.1) as bytes. Here it is completed with an empty
signature, parsed as every certificate is, and only the two forms that an authority issues are
accepted: the identity of a node, and an intermediate. Both must be of its own trust domain and name
it as the issuer, so that its key cannot be made to sign a certificate of any other form.
"""

from typing import Final, NamedTuple

from cryptography import x509

from ca import svid
from ca.errors import CertificateRefused, NameRefused
from ca.names import parse_spiffe_id

_SEQUENCE: Final = b"\x30"
# AlgorithmIdentifier: ecdsa-with-SHA256, without parameters (RFC 5758 section 3.2).
_ECDSA_WITH_SHA256: Final = bytes.fromhex("300a06082a8648ce3d040302")
# A BIT STRING of no unused bits with an ECDSA-Sig-Value of r = s = 1: nothing verifies it.
_NO_SIGNATURE: Final = bytes.fromhex("0309003006020101020101")


class UnsignedCertificate(NamedTuple):
    """What is to be certified: a node's name, or the trust domain of an intermediate."""

    name: str
    is_intermediate: bool


def read_unsigned(content: bytes, issuer: x509.Name, domain: str) -> UnsignedCertificate:
    """Read a TBSCertificate (DER) that `issuer`, an authority of `domain`, is to sign.

    Raises:
        CertificateRefused: malformed, another issuer, trust domain or form.
    """
    certificate = svid.parse(_completed(content))
    found = svid.certificate_signature(certificate, issuer)
    if found is None or found.content != content:
        raise CertificateRefused("a certificate of another issuer, algorithm or form")
    svid.key_of(certificate)
    svid.validity(certificate)
    extensions = svid.extensions(certificate)
    if svid.is_authority(extensions):
        svid.check_intermediate(extensions)
        if svid.trust_domain(extensions) != domain:
            raise CertificateRefused("an intermediate of another trust domain")
        return UnsignedCertificate(domain, is_intermediate=True)
    svid.check_leaf(extensions)
    svid.has_wildcard(extensions)
    return UnsignedCertificate(_name(svid.only_uri(extensions), domain), is_intermediate=False)


def _name(uri: str, domain: str) -> str:
    try:
        of_domain, name = parse_spiffe_id(uri)
    except NameRefused as error:
        raise CertificateRefused(f"a certificate whose name is invalid: {error}") from error
    if of_domain != domain:
        raise CertificateRefused("an identity of another trust domain")
    return name


def _completed(content: bytes) -> bytes:
    """The certificate: the content, the algorithm, and a signature of nobody."""
    body = content + _ECDSA_WITH_SHA256 + _NO_SIGNATURE
    return _SEQUENCE + _length(len(body)) + body


def _length(size: int) -> bytes:
    """The length octets of DER (X.690 section 8.1.3)."""
    if size < 0x80:
        return bytes((size,))
    octets = size.to_bytes((size.bit_length() + 7) // 8)
    return bytes((0x80 | len(octets),)) + octets
