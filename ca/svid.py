"""The form of rossec's certificates: X.509-SVIDs of SPIFFE with every freedom removed.

Each function checks one part of a parsed certificate and refuses every other form; trust and
validity times are checked by `ca.certificates`. `cryptography` parses lazily, so a malformed part
may be found at any access: each access converts its exceptions into ours.
"""

from typing import Final, NamedTuple, NoReturn

from cryptography import x509
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.utils import CryptographyDeprecationWarning
from cryptography.x509.oid import ExtensionOID, SignatureAlgorithmOID

from ca.errors import CertificateRefused, KeyRefused, NameRefused
from ca.keys.publickey import require_p256
from ca.names import check_domain

SCHEME: Final = "spiffe://"
MAX_CERTIFICATE: Final = 2048  # a leaf with the longest name has about 900 bytes
# All that `cryptography` raises for malformed DER; some of these are not a ValueError.
PARSE_ERRORS: Final = (
    ValueError, TypeError, UnsupportedAlgorithm,
    x509.InvalidVersion, x509.DuplicateExtension, x509.UnsupportedGeneralNameType,
    CryptographyDeprecationWarning,  # an error where warnings are errors
)  # fmt: skip
# Private, from a UUID (ITU-T X.667); the value is NULL. Never critical: a verifier that does not
# know it sees an identity for one name, which is less, so ignoring it is safe (RFC 5280, 4.2).
WILDCARD: Final = x509.ObjectIdentifier("2.25.176961642418767879325470120852094281072")
WILDCARD_VALUE: Final = b"\x05\x00"
_ECDSA: Final = ec.ECDSA(hashes.SHA256())
_USAGES: Final = (
    "digital_signature", "content_commitment", "key_encipherment", "data_encipherment",
    "key_agreement", "key_cert_sign", "crl_sign",
)  # fmt: skip
_UNDERSTOOD: Final = frozenset(
    {
        ExtensionOID.BASIC_CONSTRAINTS,
        ExtensionOID.KEY_USAGE,
        ExtensionOID.SUBJECT_ALTERNATIVE_NAME,
    }
)


def parse(der: bytes) -> x509.Certificate:
    """Parse DER; the size is checked first."""
    if len(der) > MAX_CERTIFICATE:
        raise CertificateRefused(
            f"a certificate of {len(der)} bytes where at most {MAX_CERTIFICATE} are allowed"
        )
    try:
        certificate = x509.load_der_x509_certificate(der)
    except PARSE_ERRORS as error:
        _malformed(error)
    if certificate.serial_number <= 0:  # the library only warns (RFC 5280 section 4.1.2.2)
        raise CertificateRefused("the certificate's serial is not a positive number")
    if not ends_with_whole_octets(der, certificate.signature):
        raise CertificateRefused("the certificate's signature is not in whole octets")
    return certificate


def ends_with_whole_octets(der: bytes, signature: bytes) -> bool:
    """Whether the BIT STRING that ends `der` claims no unused bits.

    That octet is not signed, and the library ignores it: without this check, one certificate
    would have two encodings.
    """
    return der.endswith(b"\0" + signature)


def subject(certificate: x509.Certificate) -> x509.Name:
    """The subject name."""
    try:
        return certificate.subject
    except PARSE_ERRORS as error:
        _malformed(error)


class CertificateSignature(NamedTuple):
    """The signed octets (TBSCertificate) of a certificate, and the signature."""

    content: bytes
    signature: bytes

    def verifies(self, key: ec.EllipticCurvePublicKey) -> bool:
        """Whether `key` made the signature; the caller has checked that it is a P-256 key."""
        try:
            key.verify(self.signature, self.content, _ECDSA)
        except InvalidSignature:
            return False
        return True


def certificate_signature(
    certificate: x509.Certificate, issuer: x509.Name
) -> CertificateSignature | None:
    """The signature, if the issuer and the algorithm are the expected ones; else None."""
    try:
        if certificate.issuer != issuer:
            return None
        if certificate.signature_algorithm_oid != SignatureAlgorithmOID.ECDSA_WITH_SHA256:
            return None
        return CertificateSignature(certificate.tbs_certificate_bytes, certificate.signature)
    except PARSE_ERRORS as error:
        _malformed(error)


def is_signed_by(
    certificate: x509.Certificate, issuer: x509.Name, key: ec.EllipticCurvePublicKey
) -> bool:
    """Whether issuer name, algorithm and signature match."""
    found = certificate_signature(certificate, issuer)
    return found is not None and found.verifies(key)


def key_of(certificate: x509.Certificate) -> ec.EllipticCurvePublicKey:
    """The certified key, which must be P-256."""
    try:
        return require_p256(certificate.public_key())
    except KeyRefused as error:
        raise CertificateRefused("the certificate's key is not a P-256 key") from error
    except PARSE_ERRORS as error:
        _malformed(error)


def validity(certificate: x509.Certificate) -> tuple[int, int]:
    """First and last second of validity."""
    try:
        start, end = certificate.not_valid_before_utc, certificate.not_valid_after_utc
    except PARSE_ERRORS as error:
        _malformed(error)
    return int(start.timestamp()), int(end.timestamp())


def extensions(certificate: x509.Certificate) -> x509.Extensions:
    """RFC 5280 section 4.2: an unknown extension may be ignored unless it is critical."""
    if certificate.version is not x509.Version.v3:
        raise CertificateRefused("the certificate is not of version 3")
    try:
        extensions = certificate.extensions
    except PARSE_ERRORS as error:
        _malformed(error)
    for extension in extensions:
        if extension.critical and extension.oid not in _UNDERSTOOD:
            raise CertificateRefused(
                f"the certificate has an unknown critical extension {extension.oid.dotted_string}"
            )
    return extensions


def check_leaf(extensions: x509.Extensions) -> None:
    """A node: critical basic constraints with cA false, key usage digitalSignature only."""
    match _critical(extensions, x509.BasicConstraints):
        case x509.BasicConstraints(ca=False):
            pass
        case _:
            raise CertificateRefused(
                "the certificate has no critical basic constraints with CA false"
            )
    if _usages(extensions) != {"digital_signature"}:
        raise CertificateRefused("the certificate's key usage is not digital signature only")


def is_authority(extensions: x509.Extensions) -> bool:
    """Whether basic constraints say so, critical or not; `check_authority` checks the rest."""
    return any(
        isinstance(extension.value, x509.BasicConstraints) and extension.value.ca
        for extension in extensions
    )


def check_authority(extensions: x509.Extensions) -> None:
    """An authority: critical basic constraints with cA true, key usage keyCertSign."""
    match _critical(extensions, x509.BasicConstraints):
        case x509.BasicConstraints(ca=True):
            pass
        case _:
            raise CertificateRefused(
                "this is not an authority's certificate", "name the ca.pem of the authority"
            )
    if "key_cert_sign" not in _usages(extensions):
        raise CertificateRefused("the authority's certificate may not sign certificates")


def check_intermediate(extensions: x509.Extensions) -> None:
    """An intermediate: as `check_authority`, with path length 0."""
    check_authority(extensions)
    if path_length(extensions) != 0:
        raise CertificateRefused("the intermediate's path length is not 0")
    if _usages(extensions) != {"key_cert_sign", "crl_sign"}:
        raise CertificateRefused(
            "the intermediate's key usage is not certificate and CRL signing only"
        )


def path_length(extensions: x509.Extensions) -> int | None:
    """The path length constraint; None: there is none."""
    constraints = _critical(extensions, x509.BasicConstraints)
    return constraints.path_length if isinstance(constraints, x509.BasicConstraints) else 0


def policies(extensions: x509.Extensions) -> frozenset[x509.ObjectIdentifier]:
    """The certificate policies."""
    return frozenset(
        information.policy_identifier
        for extension in extensions
        if isinstance(extension.value, x509.CertificatePolicies)
        for information in extension.value
    )


def trust_domain(extensions: x509.Extensions) -> str:
    """The trust domain of an authority: its only URI, a SPIFFE ID without a path."""
    uri = only_uri(extensions)
    try:
        if uri.startswith(SCHEME):
            return check_domain(uri.removeprefix(SCHEME))
    except NameRefused as error:
        raise CertificateRefused(f"the authority's name is invalid: {error}") from error
    raise CertificateRefused("the authority's name is not a SPIFFE trust domain")


def _usages(extensions: x509.Extensions) -> set[str]:
    usage = _critical(extensions, x509.KeyUsage)
    return {name for name in _USAGES if getattr(usage, name, False)}


def _critical(
    extensions: x509.Extensions, kind: type[x509.ExtensionType]
) -> x509.ExtensionType | None:
    for extension in extensions:
        if isinstance(extension.value, kind) and extension.critical:
            return extension.value
    return None


def only_uri(extensions: x509.Extensions) -> str:
    """The only subject alternative name, a URI; its content is not checked here."""
    names = [
        name
        for extension in extensions
        if isinstance(extension.value, x509.SubjectAlternativeName)
        for name in extension.value
    ]
    match names:
        case [x509.UniformResourceIdentifier(value=uri)]:
            return uri
        case _:
            raise CertificateRefused(
                f"the certificate has {len(names)} names where exactly one URI is allowed"
            )


def claimed_domain(certificate: x509.Certificate) -> str:
    """The trust domain that a certificate names, whoever signed it; empty: none."""
    uri = only_uri(extensions(certificate))
    domain = uri.removeprefix(SCHEME).partition("/")[0]
    try:
        return check_domain(domain) if uri.startswith(SCHEME) else ""
    except NameRefused:
        return ""


def has_wildcard(extensions: x509.Extensions) -> bool:
    """Whether the identity also stands for its name with any tail (`ca.names.covers`)."""
    for extension in extensions:
        if extension.oid == WILDCARD:
            if extension.value.public_bytes() != WILDCARD_VALUE:
                raise CertificateRefused("the certificate's wildcard is malformed")
            return True
    return False


def is_wildcard(der: bytes) -> bool:
    """`has_wildcard` for a certificate in DER, which is not verified here."""
    return has_wildcard(extensions(parse(der)))


def _malformed(error: Exception) -> NoReturn:
    raise CertificateRefused("this is not a well-formed certificate") from error
