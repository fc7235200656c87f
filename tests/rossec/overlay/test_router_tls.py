from ipaddress import ip_address
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec, ed25519
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

from rossec.errors import ConfigurationError
from rossec.overlay.router_tls import DAY, LIFETIME, RouterAuthority, key_pem, load_key
from tests.support.pki import NOW

HOSTS = ("router.example.org", "192.0.2.7", "::1")


def new_key() -> ec.EllipticCurvePrivateKey:
    return ec.generate_private_key(ec.SECP256R1())


@pytest.fixture
def authority() -> RouterAuthority:
    return RouterAuthority.create(new_key(), now=NOW, serial=1)


def _issued(authority: RouterAuthority, *, now: int = NOW) -> tuple[ec.EllipticCurvePrivateKey, bytes]:
    key = new_key()
    return key, authority.issue(key.public_key(), HOSTS, now=now, serial=2)


def test_an_authority_is_loaded_as_it_was_made(authority: RouterAuthority) -> None:
    loaded = RouterAuthority.load(key_pem(authority.key), authority.pem)
    assert loaded.pem == authority.pem
    assert loaded.key.private_numbers() == authority.key.private_numbers()


def test_a_router_is_certified_for_its_names_and_addresses(authority: RouterAuthority) -> None:
    _, pem = _issued(authority)
    leaf = x509.load_pem_x509_certificate(pem)
    leaf.verify_directly_issued_by(authority.certificate)
    names = leaf.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert names.get_values_for_type(x509.DNSName) == ["router.example.org"]
    addresses = names.get_values_for_type(x509.IPAddress)
    assert addresses == [ip_address("192.0.2.7"), ip_address("::1")]
    assert leaf.extensions.get_extension_for_class(x509.BasicConstraints).value.ca is False
    assert leaf.subject.rfc4514_string() == "CN=rossec router"


def test_other_tls_libraries_verify_it(authority: RouterAuthority) -> None:
    _, pem = _issued(authority)
    store = x509.verification.Store([authority.certificate])
    builder = x509.verification.PolicyBuilder().store(store)
    at = x509.load_pem_x509_certificate(pem).not_valid_before_utc
    verifier = builder.time(at.replace(tzinfo=None)).build_server_verifier(x509.DNSName("router.example.org"))
    assert len(verifier.verify(x509.load_pem_x509_certificate(pem), [])) == 2


def test_a_certificate_is_current_until_two_thirds_of_its_time(authority: RouterAuthority) -> None:
    key, pem = _issued(authority)
    own = key_pem(key)
    assert authority.is_current(pem, own, HOSTS, now=NOW + 200 * DAY)
    assert not authority.is_current(pem, own, HOSTS, now=NOW + 250 * DAY)


def test_what_is_not_current(authority: RouterAuthority) -> None:
    key, pem = _issued(authority)
    own = key_pem(key)
    other = RouterAuthority.create(new_key(), now=NOW, serial=1)
    assert not authority.is_current(pem, own, HOSTS[:1], now=NOW)
    assert not authority.is_current(pem, key_pem(new_key()), HOSTS, now=NOW)
    assert not authority.is_current(b"damaged", own, HOSTS, now=NOW)
    assert not authority.is_current(pem, b"damaged", HOSTS, now=NOW)
    assert not other.is_current(pem, own, HOSTS, now=NOW)


def test_an_authority_that_is_not_valid_issues_nothing(authority: RouterAuthority) -> None:
    for now in (NOW - DAY, NOW + LIFETIME + DAY):
        with pytest.raises(ConfigurationError, match="is not valid now"):
            _issued(authority, now=now)


def test_a_router_is_never_certified_longer_than_its_authority(authority: RouterAuthority) -> None:
    _, pem = _issued(authority, now=NOW + LIFETIME - DAY)
    end = x509.load_pem_x509_certificate(pem).not_valid_after_utc
    assert end == authority.certificate.not_valid_after_utc


def test_damaged_files_are_refused(authority: RouterAuthority, tmp_path: Path) -> None:
    key = key_pem(authority.key)
    other = ed25519.Ed25519PrivateKey.generate().private_bytes(
        Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()
    )
    with pytest.raises(ConfigurationError, match="certificate is damaged"):
        RouterAuthority.load(key, b"damaged")
    with pytest.raises(ConfigurationError, match="certificate is damaged"):
        RouterAuthority.load(key, authority.pem * 2)
    with pytest.raises(ConfigurationError, match="has another key"):
        RouterAuthority.load(key_pem(new_key()), authority.pem)
    with pytest.raises(ConfigurationError, match="is damaged"):
        load_key(b"damaged")
    with pytest.raises(ConfigurationError, match="not a P-256 key"):
        load_key(other)
