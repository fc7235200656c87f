from dataclasses import replace
from pathlib import Path

import pytest

from rossec.console.options import ConsoleOptions, read_options
from rossec.console.tls import certificates
from rossec.console.tls.certificates import key_pem, open_authority, prepare_tls
from rossec.errors import ConfigurationError
from tests.support.console_tls import NAME, NOW, new_authority, new_key, pem

LAN = read_options(ConsoleOptions(lan=True, name=NAME), "hall")


def test_without_tls_nothing_is_made(tmp_path: Path) -> None:
    assert prepare_tls(read_options(ConsoleOptions(), "hall"), tmp_path, NOW, rename=False) is None
    assert list(tmp_path.iterdir()) == []


def test_on_the_network_an_authority_is_made_and_used(tmp_path: Path) -> None:
    setup = prepare_tls(LAN, tmp_path / "console", NOW, rename=False)
    assert setup is not None
    assert setup.authority is not None
    assert setup.authority.data == open_authority(tmp_path / "console").data
    assert setup.authority.address == certificates.first_address()
    assert setup.source.first(NOW).count(b"BEGIN CERTIFICATE") == 1


def test_another_name_needs_rename(tmp_path: Path) -> None:
    prepare_tls(LAN, tmp_path / "console", NOW, rename=False)
    other = replace(LAN, name="other.local")
    with pytest.raises(ConfigurationError, match="not as other"):
        prepare_tls(other, tmp_path / "console", NOW, rename=False)
    setup = prepare_tls(other, tmp_path / "console", NOW, rename=True)
    assert setup is not None
    assert setup.authority is not None
    assert setup.authority.name == "other.local"


def test_files_are_checked_before_anything_listens(tmp_path: Path) -> None:
    certificate, key = tmp_path / "chain.pem", tmp_path / "key.pem"
    private = new_key()
    leaf = new_authority().issue(private.public_key(), now=NOW, serial=1)
    certificate.write_bytes(pem(leaf))
    key.write_bytes(key_pem(private))
    options = ConsoleOptions(tls_certificate=certificate, tls_key=key, name=NAME)
    setup = prepare_tls(read_options(options, "hall"), tmp_path / "console", NOW, rename=False)
    assert setup is not None
    assert setup.authority is None
    key.write_bytes(key_pem(new_key()))
    with pytest.raises(ConfigurationError, match="not the key of"):
        prepare_tls(read_options(options, "hall"), tmp_path / "console", NOW, rename=False)


def test_an_endpoint_without_its_files_is_refused(tmp_path: Path) -> None:
    options = ConsoleOptions(tls_certificate=tmp_path, tls_key=tmp_path, name=NAME)
    endpoint = replace(read_options(options, "hall"), tls_key=None)
    with pytest.raises(ConfigurationError, match="needs its key"):
        prepare_tls(endpoint, tmp_path, NOW, rename=False)
