import ipaddress
import re
from datetime import UTC, datetime
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from rossec.console.tls.certificates import DAY, LEAF_LIFETIME, LIFETIME, TlsAuthority
from rossec.errors import ConfigurationError
from tests.support.console_tls import (
    HOST,
    NAME,
    NOW,
    foreign_leaf,
    new_authority,
    new_key,
    openssl_verify,
    pem,
)


def test_the_authority_is_what_browsers_may_trust() -> None:
    certificate = x509.load_der_x509_certificate(new_authority().data)
    extensions = certificate.extensions
    basic = extensions.get_extension_for_class(x509.BasicConstraints)
    usage = extensions.get_extension_for_class(x509.KeyUsage)
    purpose = extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
    assert (basic.critical, basic.value.ca, basic.value.path_length) == (True, True, 0)
    assert usage.critical
    assert usage.value.key_cert_sign
    assert not usage.value.digital_signature
    assert list(purpose) == [ExtendedKeyUsageOID.SERVER_AUTH]
    assert certificate.not_valid_after_utc == datetime.fromtimestamp(NOW + LIFETIME, UTC)
    assert len(new_authority().data) < 800


def test_its_constraints_are_critical_and_name_one_host() -> None:
    certificate = x509.load_der_x509_certificate(new_authority().data)
    found = certificate.extensions.get_extension_for_class(x509.NameConstraints)
    assert found.critical
    assert found.value.permitted_subtrees is not None
    assert x509.DNSName(NAME) in found.value.permitted_subtrees
    assert x509.IPAddress(ipaddress.ip_network("192.168.1.5/32")) in found.value.permitted_subtrees
    assert found.value.excluded_subtrees == [x509.IPAddress(ipaddress.ip_network("::/0"))]


def test_an_address_of_version_6_is_one_host() -> None:
    address = ipaddress.IPv6Address("fd00::7")
    made = TlsAuthority.create(new_key(), NAME, address, now=NOW, serial=1)
    found = x509.load_der_x509_certificate(made.data).extensions.get_extension_for_class(x509.NameConstraints)
    assert found.value.permitted_subtrees is not None
    assert x509.IPAddress(ipaddress.ip_network("fd00::7/128")) in found.value.permitted_subtrees
    assert made.address == address


def test_what_it_issues_is_valid_to_openssl(tmp_path: Path) -> None:
    authority = new_authority()
    leaf = pem(authority.issue(new_key().public_key(), now=NOW, serial=2, address=HOST))
    assert openssl_verify(tmp_path, authority, leaf, "-verify_hostname", NAME) == ""
    assert openssl_verify(tmp_path, authority, leaf, "-verify_ip", str(HOST)) == ""
    assert "hostname mismatch" in openssl_verify(tmp_path, authority, leaf, "-verify_hostname", "other.local")


@pytest.mark.parametrize("address", [None, ipaddress.IPv4Address("192.168.1.9")])
def test_an_address_that_is_not_the_authority_s_is_left_out(
    tmp_path: Path, address: ipaddress.IPv4Address | None
) -> None:
    authority = new_authority()
    leaf = authority.issue(new_key().public_key(), now=NOW, serial=2, address=address)
    names = x509.load_der_x509_certificate(leaf).extensions.get_extension_for_class(
        x509.SubjectAlternativeName
    )
    assert list(names.value) == [x509.DNSName(NAME)]
    assert openssl_verify(tmp_path, authority, pem(leaf)) == ""


FOREIGN: dict[str, x509.GeneralName] = {
    "another name": x509.DNSName("bank.example"),
    "a name that ends alike": x509.DNSName(f"not{NAME}"),
    "a name above": x509.DNSName("local"),
    "a wildcard": x509.DNSName("*.local"),
    "another address": x509.IPAddress(ipaddress.IPv4Address("192.168.1.6")),
    "an address of the other version": x509.IPAddress(ipaddress.IPv6Address("fd00::1")),
    "an inbox": x509.RFC822Name("me@bank.example"),
    "a URI": x509.UniformResourceIdentifier("https://bank.example/"),
    "a directory name": x509.DirectoryName(
        x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "bank.example")])
    ),
}


@pytest.mark.parametrize("what", sorted(FOREIGN))
@pytest.mark.parametrize("host", [HOST, None])
def test_openssl_refuses_what_its_key_signs_for_others(
    tmp_path: Path, what: str, host: ipaddress.IPv4Address | None
) -> None:
    authority = new_authority(address=host)
    leaf = foreign_leaf(authority, new_key(), [x509.DNSName(NAME), FOREIGN[what]])
    assert re.search(
        "permitted subtree violation|excluded subtree violation", openssl_verify(tmp_path, authority, leaf)
    )


def test_openssl_refuses_a_subject_that_passes_for_another_name(tmp_path: Path) -> None:
    authority = new_authority()
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "bank.example")])
    leaf = foreign_leaf(authority, new_key(), [], subject)
    assert "subtree violation" in openssl_verify(tmp_path, authority, leaf)


def test_a_leaf_ends_after_90_days_and_with_its_authority() -> None:
    authority = new_authority()
    first = x509.load_der_x509_certificate(authority.issue(new_key().public_key(), now=NOW, serial=2))
    assert first.not_valid_after_utc == datetime.fromtimestamp(NOW + LEAF_LIFETIME, UTC)
    late = authority.issue(new_key().public_key(), now=NOW + 350 * DAY, serial=2)
    end = x509.load_der_x509_certificate(late).not_valid_after_utc
    assert end == datetime.fromtimestamp(authority.not_after, UTC)


@pytest.mark.parametrize(
    ("now", "reason"),
    [(NOW + LIFETIME + 1, "has expired"), (NOW - DAY, "is not valid yet")],
    ids=["late", "early"],
)
def test_an_authority_out_of_its_time_issues_nothing(now: int, reason: str) -> None:
    with pytest.raises(ConfigurationError, match=reason):
        new_authority().issue(new_key().public_key(), now=now, serial=2)


def test_it_is_read_as_it_was_made() -> None:
    made = new_authority()
    assert TlsAuthority.load(made.key, made.data) == made
    assert (made.name, made.address) == (NAME, HOST)


def test_the_certificate_of_another_key_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="of another key"):
        TlsAuthority.load(new_key(), new_authority().data)


def test_a_certificate_of_another_form_is_refused() -> None:
    authority = new_authority()
    leaf = authority.issue(authority.key.public_key(), now=NOW, serial=2)
    for data in (b"", b"\x30\x03", leaf):
        with pytest.raises(ConfigurationError, match="is damaged"):
            TlsAuthority.load(authority.key, data)


def test_a_long_name_is_no_obstacle(tmp_path: Path) -> None:
    name = ".".join(["a" * 60] * 4)
    authority = TlsAuthority.create(new_key(), name, None, now=NOW, serial=1)
    leaf = pem(authority.issue(new_key().public_key(), now=NOW, serial=2))
    assert openssl_verify(tmp_path, authority, leaf, "-verify_hostname", name) == ""
