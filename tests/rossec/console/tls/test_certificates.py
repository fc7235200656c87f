import logging
import os
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.hazmat.primitives.serialization import (
    BestAvailableEncryption,
    Encoding,
    NoEncryption,
    PrivateFormat,
)

from rossec.console.tls.certificates import (
    DAY,
    LEAF_LIFETIME,
    FileCertificates,
    OwnCertificates,
    TlsAuthority,
    check_bundle,
    key_pem,
    renewal_time,
)
from rossec.errors import ConfigurationError
from tests.support.console_tls import HOST, NAME, NOW, foreign_leaf, new_authority, new_key, pem


def leaf_of(bundle: bytes) -> x509.Certificate:
    return x509.load_pem_x509_certificate(bundle)


def own(authority: TlsAuthority | None = None) -> OwnCertificates:
    return OwnCertificates(authority or new_authority(), HOST, iter(range(1, 99)).__next__)


def test_an_own_certificate_is_replaced_at_two_thirds_with_another_key() -> None:
    source = own()
    first = source.first(NOW)
    due = NOW + LEAF_LIFETIME * 2 // 3
    assert source.newer(due - 1) is None
    second = source.newer(due)
    assert second is not None
    assert leaf_of(first).public_key() != leaf_of(second).public_key()
    assert leaf_of(second).not_valid_after_utc > leaf_of(first).not_valid_after_utc
    assert source.newer(due + 1) is None


def test_an_authority_that_ended_is_said_once_an_hour(caplog: pytest.LogCaptureFixture) -> None:
    source = own()
    source.first(NOW)
    later = NOW + 400 * DAY
    with caplog.at_level(logging.ERROR):
        assert [source.newer(later), source.newer(later + 1), source.newer(later + 3600)] == [None] * 3
    assert [record.getMessage().count("has expired") for record in caplog.records] == [1, 1]


def test_an_authority_that_ended_does_not_begin() -> None:
    with pytest.raises(ConfigurationError, match="has expired"):
        own().first(NOW + 400 * DAY)


def test_two_thirds() -> None:
    assert renewal_time(100, 400) == 300


class Files:
    """The operator's certificate and key."""

    def __init__(self, directory: Path) -> None:
        self.certificate, self.key = directory / "fullchain.pem", directory / "privkey.pem"
        self.authority = new_authority()
        self.write()

    def write(self, now: int = NOW) -> None:
        key = new_key()
        leaf = self.authority.issue(key.public_key(), now=now, serial=3)
        self.certificate.write_bytes(pem(leaf))
        self.key.write_bytes(key_pem(key))

    def source(self, name: str = NAME) -> FileCertificates:
        return FileCertificates(self.certificate, self.key, name)


@pytest.fixture
def files(tmp_path: Path) -> Files:
    return Files(tmp_path)


def test_files_are_read_again_when_they_are_renewed(files: Files) -> None:
    source = files.source()
    first = source.first(NOW)
    assert source.newer(NOW + 60) is None
    files.write(NOW + DAY)
    second = source.newer(NOW + DAY)
    assert second is not None
    assert leaf_of(second).not_valid_after_utc > leaf_of(first).not_valid_after_utc
    assert source.newer(NOW + DAY) is None


def test_files_may_be_links_as_those_of_acme_clients(files: Files, tmp_path: Path) -> None:
    link = tmp_path / "live.pem"
    link.symlink_to(files.certificate)
    source = FileCertificates(link, files.key, NAME)
    assert source.first(NOW).count(b"BEGIN CERTIFICATE") == 1


def test_a_renewal_that_is_half_done_is_not_used(files: Files, caplog: pytest.LogCaptureFixture) -> None:
    source = files.source()
    source.first(NOW)
    other = key_pem(new_key())
    files.key.write_bytes(other)
    with caplog.at_level(logging.ERROR):
        assert source.newer(NOW) is None
    assert "not the key of" in caplog.text
    files.key.unlink()
    assert source.newer(NOW) is None
    files.write(NOW + 1)
    assert source.newer(NOW) is not None


def test_a_missing_file_is_said(files: Files) -> None:
    files.certificate.unlink()
    with pytest.raises(ConfigurationError, match=r"there is no .*fullchain"):
        files.source().first(NOW)


def test_files_that_others_could_have_written_are_refused(files: Files) -> None:
    files.key.chmod(0o666)
    with pytest.raises(Exception, match="can be written by others"):
        files.source().first(NOW)


@pytest.mark.parametrize("listed", [NAME, "*.local", "ROSSEC.local"])
def test_a_certificate_names_the_console(listed: str) -> None:
    key = new_key()
    leaf = foreign_leaf(new_authority(), key, [x509.DNSName(listed)])
    check_bundle(leaf, key_pem(key), NAME, NOW)


def test_the_key_may_be_rsa() -> None:
    key = rsa.generate_private_key(65537, 2048)
    with pytest.raises(ConfigurationError, match="not the key of"):
        check_bundle(
            pem(new_authority().data),
            key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()),
            NAME,
            NOW,
        )


@pytest.mark.parametrize("listed", [[], ["other.local"], ["*.rossec.local"], ["local"]])
def test_a_certificate_for_another_name_is_refused(listed: list[str]) -> None:
    key = new_key()
    leaf = foreign_leaf(new_authority(), key, [x509.DNSName(name) for name in listed])
    with pytest.raises(ConfigurationError, match="is not for rossec"):
        check_bundle(leaf, key_pem(key), NAME, NOW)


def test_what_cannot_serve_is_refused_with_the_reason() -> None:
    key = new_key()
    leaf = pem(new_authority().issue(key.public_key(), now=NOW, serial=1))
    locked = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, BestAvailableEncryption(b"x"))
    for chain, private, now, reason in (
        (b"", key_pem(key), NOW, "has no PEM certificate"),
        (leaf, b"", NOW, "has no private key"),
        (leaf, locked, NOW, "has no private key"),
        (leaf, key_pem(new_key()), NOW, "not the key of"),
        (leaf, key_pem(key), NOW + 91 * DAY, "has expired"),
    ):
        with pytest.raises(ConfigurationError, match=reason):
            check_bundle(chain, private, NAME, now)


def test_a_state_that_cannot_be_read_is_not_a_renewal(files: Files) -> None:
    source = files.source()
    source.first(NOW)
    os.utime(files.key, ns=(1, 1))
    assert source.newer(NOW) is not None
