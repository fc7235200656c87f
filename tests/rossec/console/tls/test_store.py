import ipaddress
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric import ec

from rossec.console.tls import certificates
from rossec.console.tls.certificates import (
    CERTIFICATE,
    DAY,
    KEY,
    authority_for,
    exists,
    open_authority,
    renew,
)
from rossec.errors import ConfigurationError
from rossec.host import addresses
from tests.support.console_tls import HOST, NAME, NOW


@pytest.fixture
def directory(tmp_path: Path) -> Path:
    return tmp_path / "ca" / "console"


def test_what_was_made_is_read_again(directory: Path) -> None:
    assert not exists(directory)
    made = renew(directory, NAME, HOST, NOW)
    assert exists(directory)
    found = open_authority(directory)
    assert (found.data, found.name, found.address) == (made.data, NAME, HOST)
    assert (directory / KEY).stat().st_mode & 0o777 == 0o600
    assert directory.stat().st_mode & 0o777 == 0o700


def test_another_one_has_another_key_and_leaves_nothing_of_the_first(directory: Path) -> None:
    first = renew(directory, NAME, None, NOW)
    second = renew(directory, "other.local", None, NOW + 1)
    assert first.key.public_key() != second.key.public_key()
    assert open_authority(directory).name == "other.local"
    assert sorted(path.name for path in directory.iterdir()) == [KEY, CERTIFICATE]


def test_there_is_none(directory: Path) -> None:
    directory.mkdir(parents=True, mode=0o700)
    with pytest.raises(ConfigurationError, match="has no TLS authority") as caught:
        open_authority(directory)
    assert "--renew" in caught.value.hint


def test_a_crash_between_key_and_certificate_is_seen(directory: Path) -> None:
    renew(directory, NAME, None, NOW)
    before = (directory / CERTIFICATE).read_bytes()
    renew(directory, NAME, None, NOW)
    (directory / CERTIFICATE).write_bytes(before)
    with pytest.raises(ConfigurationError, match="of another key") as caught:
        open_authority(directory)
    assert "--renew" in caught.value.hint
    renew(directory, NAME, None, NOW)
    assert open_authority(directory).name == NAME


def test_a_key_that_others_can_read_is_refused(directory: Path) -> None:
    renew(directory, NAME, None, NOW)
    (directory / KEY).chmod(0o640)
    with pytest.raises(ConfigurationError, match="can be read by others"):
        open_authority(directory)


@pytest.mark.parametrize("file", [KEY, CERTIFICATE])
def test_a_damaged_file_is_refused(directory: Path, file: str) -> None:
    renew(directory, NAME, None, NOW)
    (directory / file).write_bytes(b"nothing")
    with pytest.raises(ConfigurationError, match=f"{file} is damaged"):
        open_authority(directory)


def test_a_key_of_another_curve_is_refused(directory: Path) -> None:
    renew(directory, NAME, None, NOW)
    (directory / KEY).write_bytes(certificates.key_pem(ec.generate_private_key(ec.SECP384R1())))
    with pytest.raises(ConfigurationError, match="not a P-256 key"):
        open_authority(directory)


def test_serials_are_positive_and_differ() -> None:
    found = {certificates.random_serial() for _ in range(100)}
    assert len(found) == 100
    assert all(0 < serial < 1 << 128 for serial in found)


def test_an_authority_is_made_once_for_a_name(directory: Path) -> None:
    first = authority_for(directory, NAME, HOST, NOW, rename=False)
    assert authority_for(directory, NAME, None, NOW + DAY, rename=False).data == first.data


def test_another_name_is_refused_unless_it_is_meant(directory: Path) -> None:
    authority_for(directory, NAME, HOST, NOW, rename=False)
    with pytest.raises(ConfigurationError, match="not as other") as caught:
        authority_for(directory, "other.local", HOST, NOW, rename=False)
    assert "--rename" in caught.value.hint
    assert open_authority(directory).name == NAME
    assert authority_for(directory, "other.local", HOST, NOW, rename=True).name == "other.local"


def test_an_authority_that_ended_is_not_used(directory: Path) -> None:
    authority_for(directory, NAME, HOST, NOW, rename=False)
    with pytest.raises(ConfigurationError, match="has expired") as caught:
        authority_for(directory, NAME, HOST, NOW + 366 * DAY, rename=False)
    assert "--renew" in caught.value.hint


@pytest.mark.parametrize(
    ("listed", "found"),
    [(["127.0.0.1", "::1"], None), (["fe80::1", "192.168.1.5"], "192.168.1.5"), (["fd00::7"], "fd00::7")],
)
def test_the_address_is_one_that_others_reach(
    monkeypatch: pytest.MonkeyPatch, listed: list[str], found: str | None
) -> None:
    monkeypatch.setattr(addresses, "own_addresses", lambda: listed)
    assert certificates.first_address() == (None if found is None else ipaddress.ip_address(found))
