import hashlib
import subprocess
from collections.abc import Sequence
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec, ed25519
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import AttributeOID, NameOID

from ca.errors import NameRefused, RequestRefused
from ca.keys.signing import thumbprint
from ca.svid import MAX_REQUEST, WILDCARD, WILDCARD_VALUE, build_request, check_request
from tests.support.pki import new_signer, uris, usage

URI = "spiffe://home/robot1/camera"
SAN = uris(URI)


def crafted(
    *extensions: tuple[x509.ExtensionType, bool],
    key: ec.EllipticCurvePrivateKey | None = None,
    subject: Sequence[x509.NameAttribute[str]] = (),
    algorithm: hashes.SHA256 | hashes.SHA384 | None = None,
    challenge: bytes | None = None,
) -> bytes:
    builder = x509.CertificateSigningRequestBuilder(x509.Name(list(subject)))
    for extension, critical in extensions:
        builder = builder.add_extension(extension, critical=critical)
    if challenge is not None:
        builder = builder.add_attribute(AttributeOID.CHALLENGE_PASSWORD, challenge)
    signing_key = key or ec.generate_private_key(ec.SECP256R1())
    return builder.sign(signing_key, algorithm or hashes.SHA256()).public_bytes(Encoding.DER)


def test_round_trip() -> None:
    signer = new_signer()
    csr = build_request(signer, "home", "/robot1/camera")
    request = check_request(csr, "home")
    assert (request.domain, request.name) == ("home", "/robot1/camera")
    assert request.public_key == signer.public_key
    assert request.thumbprint == thumbprint(signer.public_key)
    assert request.digest == hashlib.sha256(csr).digest()


def test_the_longest_name_fits() -> None:
    name = "/" + "a" * 254
    csr = build_request(new_signer(), "d" * 255, name)
    assert len(csr) < MAX_REQUEST
    assert check_request(csr, "d" * 255).name == name


def test_openssl_understands_it(tmp_path: Path) -> None:
    path = tmp_path / "node.csr"
    path.write_bytes(build_request(new_signer(), "home", "/robot1/camera"))
    done = subprocess.run(
        ["openssl", "req", "-inform", "DER", "-in", path, "-noout", "-verify", "-text"],
        capture_output=True,
        check=True,
    )
    assert b"URI:spiffe://home/robot1/camera" in done.stdout


def test_no_request_for_a_bad_name() -> None:
    with pytest.raises(NameRefused):
        build_request(new_signer(), "home", "camera")


def test_size_comes_first() -> None:
    with pytest.raises(RequestRefused, match="a request of 2049 bytes where at most 2048"):
        check_request(bytes(MAX_REQUEST + 1), "home")


CSR = build_request(new_signer(), "home", "/robot1/camera")


@pytest.mark.parametrize("data", [b"", b"garbage", CSR[:-1], CSR + b"\0"])
def test_garbage_is_not_a_request(data: bytes) -> None:
    with pytest.raises(RequestRefused, match="this is not a certificate request") as caught:
        check_request(data, "home")
    assert "rossec node request" in caught.value.hint


def test_every_byte_counts() -> None:
    for position in range(len(CSR)):
        for change in (0x01, 0x80, 0xFF):
            damaged = bytearray(CSR)
            damaged[position] ^= change
            with pytest.raises(RequestRefused):
                check_request(bytes(damaged), "home")


def test_every_truncation() -> None:
    for size in range(len(CSR)):
        with pytest.raises(RequestRefused):
            check_request(CSR[:size], "home")


def test_the_key_must_be_proven() -> None:
    damaged = bytearray(CSR)
    damaged[-1] ^= 1
    with pytest.raises(RequestRefused, match="does not prove that the node has the key"):
        check_request(bytes(damaged), "home")


def test_the_signature_has_no_unused_bits() -> None:
    """An even last octet would allow the claim of one unused bit, outside what is signed."""
    csr = crafted((SAN, True))
    while csr[-1] & 1:
        csr = crafted((SAN, True))
    size = len(x509.load_der_x509_csr(csr).signature)
    twisted = bytearray(csr)
    twisted[-size - 1] = 1
    with pytest.raises(RequestRefused, match="signature is not in whole octets"):
        check_request(bytes(twisted), "home")


CA_TRUE = x509.BasicConstraints(ca=True, path_length=None)
CA_FALSE = x509.BasicConstraints(ca=False, path_length=None)
UNKNOWN = x509.UnrecognizedExtension(x509.ObjectIdentifier("1.2.3.4"), b"\x05\x00")
TAIL = x509.UnrecognizedExtension(WILDCARD, WILDCARD_VALUE)
ODD_TAIL = x509.UnrecognizedExtension(WILDCARD, b"\x01\x01\xff")
COMMON_NAME = [x509.NameAttribute(NameOID.COMMON_NAME, "robot")]


@pytest.mark.parametrize(
    ("csr", "message"),
    [
        (crafted((SAN, True), key=ec.generate_private_key(ec.SECP384R1())), "a key that is not P-2"),
        (crafted((SAN, True), algorithm=hashes.SHA384()), "is not signed with ECDSA and SHA-256"),
        (crafted((SAN, True), subject=COMMON_NAME), "asks for a subject"),
        (crafted((SAN, True), challenge=b"x"), "has other attributes than its extensions"),
        (crafted(), "has other attributes than its extensions"),
        (crafted((SAN, True), (CA_TRUE, True)), "asks to be an authority"),
        (crafted((SAN, True), (CA_FALSE, True)), "asks for extension BASIC_CONSTRAINTS"),
        (crafted((SAN, True), (usage("key_cert_sign"), True)), "asks for extension KEY_USAGE"),
        (crafted((SAN, True), (UNKNOWN, False)), r"asks for extension 1\.2\.3\.4"),
        (crafted((SAN, True), (TAIL, False)), "asks for all names that begin with /robot1/camera_"),
        (crafted((SAN, True), (ODD_TAIL, False)), r"asks for extension 2\.25\.1769"),
        (crafted((uris(URI, URI), True)), "asks for 2 names where exactly one URI"),
        (crafted((uris(), True)), "asks for 0 names where exactly one URI"),
        (
            crafted((x509.SubjectAlternativeName([x509.DNSName("camera")]), True)),
            "asks for 1 names where exactly one URI",
        ),
        (crafted((uris("https://home/a"), True)), "asks for an invalid name: .*no.*SPIFFE ID"),
        (crafted((uris("spiffe://home/a/"), True)), "asks for an invalid name: '/a/' is not"),
        (crafted((uris("spiffe://lab/a"), True)), "for trust domain 'lab', this authority is 'ho"),
    ],
)
def test_requests_for_anything_else_are_refused(csr: bytes, message: str) -> None:
    with pytest.raises(RequestRefused, match=message) as caught:
        check_request(csr, "home")
    assert caught.value.hint


def test_ed25519_is_not_p256() -> None:
    builder = x509.CertificateSigningRequestBuilder(x509.Name([])).add_extension(SAN, critical=True)
    csr = builder.sign(ed25519.Ed25519PrivateKey.generate(), None).public_bytes(Encoding.DER)
    with pytest.raises(RequestRefused, match="for a key that is not P-256"):
        check_request(csr, "home")


def test_a_wildcard_tail_only_where_the_approver_means_it() -> None:
    csr = build_request(new_signer(), "home", "/rviz", wildcard=True)
    with pytest.raises(RequestRefused, match="all names that begin with /rviz_") as caught:
        check_request(csr, "home")
    assert "--anonymous" in caught.value.hint
    assert check_request(csr, "home", wildcard=True).wildcard
    assert not check_request(CSR, "home", wildcard=True).wildcard


def test_allowing_a_tail_allows_nothing_else() -> None:
    for extension in (ODD_TAIL, UNKNOWN, CA_TRUE):
        with pytest.raises(RequestRefused):
            check_request(crafted((SAN, True), (extension, False)), "home", wildcard=True)


def test_no_request_for_the_masters_tail() -> None:
    with pytest.raises(NameRefused, match="/master is a single node"):
        build_request(new_signer(), "home", "/master", wildcard=True)
