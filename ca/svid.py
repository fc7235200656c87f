"""The form of rossec's certificates and requests: X.509-SVIDs of SPIFFE with every freedom removed.

Each function checks one part and refuses every other form; trust and validity times are checked by
`ca.certificates`. A request is a PKCS#10 CSR in the one form that `build_request` writes.
"""

import hashlib
from dataclasses import dataclass
from typing import Final, NamedTuple, NoReturn, TypeVar

from cryptography import x509
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.utils import CryptographyDeprecationWarning
from cryptography.x509.oid import ExtensionOID, SignatureAlgorithmOID

from ca.errors import CertificateRefused, KeyRefused, NameRefused, RequestRefused
from ca.keys.signing import Signer, X509Signer, require_p256, thumbprint
from ca.names import SCHEME, check_domain, check_wildcard, parse_spiffe_id, refuse_alias, spiffe_id

MAX_CERTIFICATE: Final = 2048  # a leaf with the longest name has about 900 bytes
# All that `cryptography` raises for malformed DER; some of these are not a ValueError.
PARSE_ERRORS: Final = (
    ValueError,
    TypeError,
    UnsupportedAlgorithm,
    x509.InvalidVersion,
    x509.DuplicateExtension,
    x509.UnsupportedGeneralNameType,
    CryptographyDeprecationWarning,  # an error where warnings are errors
)
# Private, from a UUID (ITU-T X.667); the value is NULL. Never critical: a verifier that does not
# know it sees an identity for one name, which is less, so ignoring it is safe (RFC 5280, 4.2).
WILDCARD: Final = x509.ObjectIdentifier("2.25.176961642418767879325470120852094281072")
WILDCARD_VALUE: Final = b"\x05\x00"
_ECDSA: Final = ec.ECDSA(hashes.SHA256())
_USAGES: Final = (
    "digital_signature",
    "content_commitment",
    "key_encipherment",
    "data_encipherment",
    "key_agreement",
    "key_cert_sign",
    "crl_sign",
)
_UNDERSTOOD: Final = frozenset(
    {ExtensionOID.BASIC_CONSTRAINTS, ExtensionOID.KEY_USAGE, ExtensionOID.SUBJECT_ALTERNATIVE_NAME}
)

MAX_REQUEST: Final = 2048  # a request for the longest name has about 800 bytes
_EXTENSION_REQUEST: Final = x509.ObjectIdentifier("1.2.840.113549.1.9.14")
_HINT: Final = "make the request on the node with `rossec node request`"


# `cryptography` parses lazily, so a malformed part may be found at any access: each access below converts
# its exceptions into ours.
_Extension = TypeVar("_Extension", bound=x509.ExtensionType)


def parse(der: bytes) -> x509.Certificate:
    # Size before parsing: a stranger sent it.
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
    """Whether the BIT STRING that ends `der` claims no unused bits."""
    # That octet is not signed, and the library ignores it: without this check, one certificate would have two
    # encodings.
    return der.endswith(b"\0" + signature)


def subject(certificate: x509.Certificate) -> x509.Name:
    try:
        return certificate.subject
    except PARSE_ERRORS as error:
        _malformed(error)


class CertificateSignature(NamedTuple):
    content: bytes
    signature: bytes

    def verifies(self, key: ec.EllipticCurvePublicKey) -> bool:
        try:
            key.verify(self.signature, self.content, _ECDSA)
        except InvalidSignature:
            return False
        return True


def certificate_signature(certificate: x509.Certificate, issuer: x509.Name) -> CertificateSignature | None:
    """The signature, if the issuer and the algorithm are the expected ones; else None."""
    try:
        # The name is compared only to say whose certificate it is not: the signature decides.
        if certificate.issuer != issuer:
            return None
        if certificate.signature_algorithm_oid != SignatureAlgorithmOID.ECDSA_WITH_SHA256:
            return None
        return CertificateSignature(certificate.tbs_certificate_bytes, certificate.signature)
    except PARSE_ERRORS as error:
        _malformed(error)


def is_signed_by(certificate: x509.Certificate, issuer: x509.Name, key: ec.EllipticCurvePublicKey) -> bool:
    found = certificate_signature(certificate, issuer)
    return found is not None and found.verifies(key)


def key_of(certificate: x509.Certificate) -> ec.EllipticCurvePublicKey:
    try:
        return require_p256(certificate.public_key())
    except KeyRefused as error:
        raise CertificateRefused("the certificate's key is not a P-256 key") from error
    except PARSE_ERRORS as error:
        _malformed(error)


def validity(certificate: x509.Certificate) -> tuple[int, int]:
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
    constraints = _critical(extensions, x509.BasicConstraints)
    if constraints is None or constraints.ca:
        raise CertificateRefused("the certificate has no critical basic constraints with CA false")
    # A leaf that may sign certificates would be an authority without saying so (X509-SVID section 4.3).
    if _usages(extensions) != {"digital_signature"}:
        raise CertificateRefused("the certificate's key usage is not digital signature only")


def is_authority(extensions: x509.Extensions) -> bool:
    return any(
        isinstance(extension.value, x509.BasicConstraints) and extension.value.ca for extension in extensions
    )


def check_authority(extensions: x509.Extensions) -> None:
    constraints = _critical(extensions, x509.BasicConstraints)
    if constraints is None or not constraints.ca:
        raise CertificateRefused("this is not an authority's certificate", "name the ca.pem of the authority")
    if "key_cert_sign" not in _usages(extensions):
        raise CertificateRefused("the authority's certificate may not sign certificates")


def check_intermediate(extensions: x509.Extensions) -> None:
    check_authority(extensions)
    if path_length(extensions) != 0:
        raise CertificateRefused("the intermediate's path length is not 0")
    if _usages(extensions) != {"key_cert_sign", "crl_sign"}:
        raise CertificateRefused("the intermediate's key usage is not certificate and CRL signing only")


def path_length(extensions: x509.Extensions) -> int | None:
    constraints = _critical(extensions, x509.BasicConstraints)
    return 0 if constraints is None else constraints.path_length


def policies(extensions: x509.Extensions) -> frozenset[x509.ObjectIdentifier]:
    return frozenset(
        information.policy_identifier
        for extension in extensions
        if isinstance(extension.value, x509.CertificatePolicies)
        for information in extension.value
    )


def trust_domain(extensions: x509.Extensions) -> str:
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


def _critical(extensions: x509.Extensions, kind: type[_Extension]) -> _Extension | None:
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


@dataclass(frozen=True)
class IdentityRequest:
    domain: str
    name: str
    public_key: ec.EllipticCurvePublicKey
    thumbprint: bytes
    digest: bytes  # SHA-256 of the DER bytes, as in the enrollment code
    wildcard: bool = False  # it requests a wildcard tail


def build_request(signer: Signer, domain: str, name: str, *, wildcard: bool = False) -> bytes:
    builder = request_builder(spiffe_id(domain, refuse_alias(name)))
    if wildcard:
        check_wildcard(name)
        builder = builder.add_extension(x509.UnrecognizedExtension(WILDCARD, WILDCARD_VALUE), critical=False)
    return sign(builder, signer)


def request_builder(uri: str) -> x509.CertificateSigningRequestBuilder:
    builder = x509.CertificateSigningRequestBuilder(x509.Name([]))
    return builder.add_extension(alternative_name(uri), critical=True)


def alternative_name(uri: str) -> x509.SubjectAlternativeName:
    return x509.SubjectAlternativeName([x509.UniformResourceIdentifier(uri)])


def sign(builder: x509.CertificateBuilder | x509.CertificateSigningRequestBuilder, signer: Signer) -> bytes:
    return builder.sign(X509Signer(signer), hashes.SHA256()).public_bytes(Encoding.DER)


def check_request(csr: bytes, domain: str, *, wildcard: bool = False) -> IdentityRequest:
    """The request in the CSR, if it is for one name in `domain` and a proven P-256 key."""
    # `wildcard`: the approver allows a wildcard tail.
    key, uri, asks = read_request(csr, _HINT)
    try:
        asked_domain, name = parse_spiffe_id(uri)
        refuse_alias(name)
    except NameRefused as error:
        raise RequestRefused(f"the request asks for an invalid name: {error}", _HINT) from error
    if asked_domain != domain:
        raise RequestRefused(
            f"the request is for trust domain {asked_domain!r}, this authority is {domain!r}",
            f"make the request on the node for {domain!r}",
        )
    if asks and not wildcard:
        raise RequestRefused(
            f"the request asks for all names that begin with {name}_",
            "only for anonymous nodes: if intended, sign it with --anonymous",
        )
    return IdentityRequest(domain, name, key, thumbprint(key), hashlib.sha256(csr).digest(), asks)


def read_request(csr: bytes, hint: str) -> tuple[ec.EllipticCurvePublicKey, str, bool]:
    if len(csr) > MAX_REQUEST:
        raise RequestRefused(f"a request of {len(csr)} bytes where at most {MAX_REQUEST} are allowed", hint)
    try:
        request = x509.load_der_x509_csr(csr)
        if not ends_with_whole_octets(csr, request.signature):
            raise RequestRefused("the request's signature is not in whole octets", hint)
        return proven_key(request), *requested_name(request)
    except PARSE_ERRORS as error:
        raise RequestRefused("this is not a certificate request", hint) from error


def proven_key(request: x509.CertificateSigningRequest) -> ec.EllipticCurvePublicKey:
    try:
        key = require_p256(request.public_key())
    except KeyRefused as error:
        raise RequestRefused("the request is for a key that is not P-256", _HINT) from error
    if request.signature_algorithm_oid != SignatureAlgorithmOID.ECDSA_WITH_SHA256:
        raise RequestRefused("the request is not signed with ECDSA and SHA-256", _HINT)
    if not request.is_signature_valid:
        raise RequestRefused(
            "the request does not prove that the node has the key", "transfer the file again"
        )
    return key


def requested_name(request: x509.CertificateSigningRequest) -> tuple[str, bool]:
    # Anything more than asked for (CA:TRUE, a second name) is refused, never silently dropped: the approver
    # sees everything that is in it.
    if len(request.subject.rdns) > 0:
        raise RequestRefused("the request asks for a subject", _HINT)
    if [attribute.oid for attribute in request.attributes] != [_EXTENSION_REQUEST]:
        raise RequestRefused("the request has other attributes than its extensions", _HINT)
    names: list[x509.GeneralName] = []
    wildcard = False
    for extension in request.extensions:
        match extension.value:
            case x509.SubjectAlternativeName() as alternative:
                names = list(alternative)
            case x509.UnrecognizedExtension(oid=oid, value=value) if (
                oid == WILDCARD and value == WILDCARD_VALUE
            ):
                wildcard = True
            case x509.BasicConstraints(ca=True):
                raise RequestRefused(
                    "the request asks to be an authority", "do not sign it: find out who made it"
                )
            case _:
                known = {oid: name for name, oid in vars(ExtensionOID).items() if not name.startswith("_")}
                asked = known.get(extension.oid, extension.oid.dotted_string)
                raise RequestRefused(f"the request asks for extension {asked}", _HINT)
    match names:
        case [x509.UniformResourceIdentifier(value=uri)]:
            return uri, wildcard
        case _:
            raise RequestRefused(
                f"the request asks for {len(names)} names where exactly one URI is allowed", _HINT
            )
