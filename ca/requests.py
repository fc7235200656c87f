"""Certificate requests: one name for one key, with proof of possession, and nothing else.

A request is a PKCS#10 CSR (so every CA tool can read it) in the one form `build_request` writes:
empty subject, one extension with one URI. The approver therefore sees everything it contains;
anything more (CA:TRUE, a second name, a key usage) is refused, never silently dropped. The only
option is a wildcard tail; it is refused as well unless the approver allowed it.
"""

import hashlib
from dataclasses import dataclass
from typing import Final

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import ExtensionOID, SignatureAlgorithmOID

from ca.domains.aliases import refuse_alias
from ca.errors import KeyRefused, NameRefused, RequestRefused
from ca.keys.publickey import require_p256, thumbprint
from ca.keys.signer import Signer
from ca.keys.x509signer import X509Signer
from ca.names import check_wildcard, parse_spiffe_id, spiffe_id
from ca.svid import PARSE_ERRORS, WILDCARD, WILDCARD_VALUE, ends_with_whole_octets

MAX_REQUEST: Final = 2048  # a request for the longest name has about 800 bytes
_EXTENSION_REQUEST: Final = x509.ObjectIdentifier("1.2.840.113549.1.9.14")
_HINT: Final = "make the request on the node with `rossec node request`"


@dataclass(frozen=True)
class IdentityRequest:
    """A verified request.

    `digest` is the SHA-256 of the DER bytes, as in the enrollment code. `wildcard`: it requests a
    wildcard tail.
    """

    domain: str
    name: str
    public_key: ec.EllipticCurvePublicKey
    thumbprint: bytes
    digest: bytes
    wildcard: bool = False


def build_request(signer: Signer, domain: str, name: str, *, wildcard: bool = False) -> bytes:
    """Return a CSR (DER) for `name` in `domain` with the signer's key.

    Raises:
        NameRefused: `domain` or `name` is not one, or this name cannot have a wildcard tail.
    """
    builder = request_builder(spiffe_id(domain, refuse_alias(name)))
    if wildcard:
        check_wildcard(name)
        builder = builder.add_extension(
            x509.UnrecognizedExtension(WILDCARD, WILDCARD_VALUE), critical=False
        )
    return builder.sign(X509Signer(signer), hashes.SHA256()).public_bytes(Encoding.DER)


def request_builder(uri: str) -> x509.CertificateSigningRequestBuilder:
    """A CSR for `uri`, to be signed."""
    names = x509.SubjectAlternativeName([x509.UniformResourceIdentifier(uri)])
    builder = x509.CertificateSigningRequestBuilder(x509.Name([]))
    return builder.add_extension(names, critical=True)


def check_request(csr: bytes, domain: str, *, wildcard: bool = False) -> IdentityRequest:
    """Return the request in the CSR, if it is for one name in `domain` and a proven P-256 key.

    Args:
        wildcard: the approver allows a wildcard tail.

    Raises:
        RequestRefused: malformed, without proof of possession, or for anything else.
    """
    key, uri, asks = read_request(csr, _HINT)
    name = _check_name(uri, domain)
    if asks and not wildcard:
        raise RequestRefused(
            f"the request asks for all names that begin with {name}_",
            "only for anonymous nodes: if intended, sign it with --anonymous",
        )
    return IdentityRequest(domain, name, key, thumbprint(key), hashlib.sha256(csr).digest(), asks)


def read_request(csr: bytes, hint: str) -> tuple[ec.EllipticCurvePublicKey, str, bool]:
    """The proven key of a CSR, the URI it is for, and whether it requests a wildcard tail.

    Raises:
        RequestRefused: malformed, or without proof of possession.
    """
    if len(csr) > MAX_REQUEST:
        raise RequestRefused(
            f"a request of {len(csr)} bytes where at most {MAX_REQUEST} are allowed", hint
        )
    try:
        request = x509.load_der_x509_csr(csr)
        if not ends_with_whole_octets(csr, request.signature):
            raise RequestRefused("the request's signature is not in whole octets", hint)
        return proven_key(request), *requested_name(request)
    except PARSE_ERRORS as error:
        raise RequestRefused("this is not a certificate request", hint) from error


def proven_key(request: x509.CertificateSigningRequest) -> ec.EllipticCurvePublicKey:
    """The P-256 key of a request that proves possession of it.

    Raises:
        RequestRefused: another kind of key or signature, or no proof.
    """
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
    """The URI that a request asks for, and whether it asks for a wildcard.

    Raises:
        RequestRefused: it contains anything else.
    """
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
                raise RequestRefused(
                    f"the request asks for extension {_extension_name(extension)}", _HINT
                )
    match names:
        case [x509.UniformResourceIdentifier(value=uri)]:
            return uri, wildcard
        case _:
            raise RequestRefused(
                f"the request asks for {len(names)} names where exactly one URI is allowed", _HINT
            )


def _check_name(uri: str, domain: str) -> str:
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
    return name


def _extension_name(extension: x509.Extension[x509.ExtensionType]) -> str:
    known = {oid: name for name, oid in vars(ExtensionOID).items() if not name.startswith("_")}
    return known.get(extension.oid, extension.oid.dotted_string)
