from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric import ec

from rossec.console.tls import store
from rossec.console.tls.store import CERTIFICATE, KEY, exists, open_authority, renew
from rossec.errors import ConfigurationError
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
    (directory / KEY).write_bytes(store.key_pem(ec.generate_private_key(ec.SECP384R1())))
    with pytest.raises(ConfigurationError, match="not a P-256 key"):
        open_authority(directory)


def test_serials_are_positive_and_differ() -> None:
    found = {store.random_serial() for _ in range(100)}
    assert len(found) == 100
    assert all(0 < serial < 1 << 128 for serial in found)
