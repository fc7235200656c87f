"""A certificate is read before it is signed: only what an authority issues, in its own name."""

import secrets

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec

from ca.authority import Authority, UnsignedCertificate, create_root, read_unsigned
from ca.certificates import build_intermediate_request
from ca.errors import CertificateRefused
from ca.keys.signing import X509Signer
from ca.svid import build_request
from tests.support.pki import new_signer

NOW = 1_800_000_000
SIGNER = new_signer()
AUTHORITY = Authority(SIGNER, create_root(SIGNER, "home", now=NOW, serial=7))
ISSUER = AUTHORITY.anchor.subject


def content(der: bytes) -> bytes:
    return x509.load_der_x509_certificate(der).tbs_certificate_bytes


def leaf(name: str = "/robot", *, wildcard: bool = False, authority: Authority = AUTHORITY) -> bytes:
    domain = authority.anchor.domain
    csr = build_request(new_signer(), domain, name, wildcard=wildcard)
    serial = secrets.randbits(127)
    return content(authority.issue(csr, now=NOW, serial=serial, wildcard=wildcard))


@pytest.mark.parametrize("wildcard", [False, True])
def test_an_identity_is_read(wildcard: bool) -> None:
    found = read_unsigned(leaf(wildcard=wildcard), ISSUER, "home")
    assert found == UnsignedCertificate("/robot", is_intermediate=False)


def test_the_longest_name_fits() -> None:
    name = "/" + "/".join(["a" * 60] * 4)
    assert read_unsigned(leaf(name), ISSUER, "home").name == name


def test_an_intermediate_is_read() -> None:
    csr = build_intermediate_request(new_signer(), "home")
    der = AUTHORITY.issue_intermediate(csr, now=NOW, serial=9, may_enroll=True, lifetime=9999)
    found = read_unsigned(content(der), ISSUER, "home")
    assert found == UnsignedCertificate("home", is_intermediate=True)


def test_a_root_is_refused() -> None:
    with pytest.raises(CertificateRefused, match="path length"):
        read_unsigned(content(AUTHORITY.anchor.certificate), ISSUER, "home")


def test_another_issuer_is_refused() -> None:
    signer = new_signer()
    other = Authority(signer, create_root(signer, "home", now=NOW, serial=8))
    with pytest.raises(CertificateRefused, match="another issuer"):
        read_unsigned(leaf(authority=other), ISSUER, "home")


@pytest.mark.parametrize("uri", ["spiffe://garden/robot", "https://home/robot", "spiffe://home"])
def test_another_domain_or_name_is_refused(uri: str) -> None:
    with pytest.raises(CertificateRefused):
        read_unsigned(built(uri=uri), ISSUER, "home")


@pytest.mark.parametrize("flaw", ["usage", "constraints", "key", "intermediate"])
def test_another_form_is_refused(flaw: str) -> None:
    with pytest.raises(CertificateRefused):
        read_unsigned(built(flaw=flaw), ISSUER, "home")


def test_the_built_one_is_accepted_without_a_flaw() -> None:
    assert read_unsigned(built(), ISSUER, "home").name == "/robot"


def test_every_cut_and_every_appended_byte_is_refused() -> None:
    good = leaf()
    for data in [*(good[:size] for size in range(len(good))), good + b"\0", b"x" * 4000]:
        with pytest.raises(CertificateRefused):
            read_unsigned(data, ISSUER, "home")


def built(uri: str = "spiffe://home/robot", flaw: str = "") -> bytes:
    """A TBSCertificate of the authority with one flaw."""
    key = ec.generate_private_key(ec.SECP384R1() if flaw == "key" else ec.SECP256R1())
    is_ca = flaw == "intermediate"
    usage = x509.KeyUsage(
        digital_signature=True,
        content_commitment=False,
        key_encipherment=flaw == "usage",
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=False,
        crl_sign=False,
        encipher_only=False,
        decipher_only=False,
    )
    certificate = x509.load_der_x509_certificate(AUTHORITY.anchor.certificate)
    builder = (
        x509.CertificateBuilder()
        .serial_number(5)
        .public_key(key.public_key())
        .not_valid_before(certificate.not_valid_before_utc)
        .not_valid_after(certificate.not_valid_after_utc)
        .subject_name(x509.Name([]))
        .issuer_name(ISSUER)
        .add_extension(usage, critical=True)
        .add_extension(x509.SubjectAlternativeName([x509.UniformResourceIdentifier(uri)]), critical=True)
    )
    if flaw != "constraints":
        limits = x509.BasicConstraints(ca=is_ca, path_length=0 if is_ca else None)
        builder = builder.add_extension(limits, critical=True)
    return builder.sign(X509Signer(SIGNER), hashes.SHA256()).tbs_certificate_bytes
