from pathlib import Path

import pytest

from ca.errors import PathRefused, TokenRefused
from ca.keys.private_keys import KeyUri
from rossec.authority import home as authority_home
from rossec.errors import ConfigurationError

MODULE, OTHER = "/usr/lib/a.so", "/usr/lib/b.so"
URI = KeyUri("home", "authority", MODULE)


def test_none_is_trusted_until_one_is_named(tmp_path: Path) -> None:
    home = tmp_path / "home"
    assert authority_home.trusted(home) == frozenset()
    for _ in range(2):
        authority_home.trust(home, MODULE)
        authority_home.trust(home, OTHER)
    assert authority_home.trusted(home) == {MODULE, OTHER}
    file = home / authority_home.FILE
    assert file.read_text() == f"{MODULE}\n{OTHER}\n"
    assert file.stat().st_mode & 0o777 == 0o600


@pytest.mark.parametrize("module", ["a.so", "./a.so", "", "/a\n/b", "../a.so"])
def test_only_an_absolute_path_is_one_file(tmp_path: Path, module: str) -> None:
    with pytest.raises(TokenRefused, match="not the absolute path"):
        authority_home.trust(tmp_path, module)
    with pytest.raises(TokenRefused, match="not the absolute path"):
        authority_home.restored_uri(str(URI).encode(), tmp_path, module)
    assert not (tmp_path / authority_home.FILE).exists()


def test_the_file_is_its_owners_and_text(tmp_path: Path) -> None:
    file = tmp_path / authority_home.FILE
    file.write_bytes(b"\xff\n")
    with pytest.raises(ConfigurationError, match="is not UTF-8"):
        authority_home.trusted(tmp_path)
    file.write_text(f"# by hand\n{MODULE}\nrelative.so\n\n")
    assert authority_home.trusted(tmp_path) == {MODULE}
    file.chmod(0o666)
    with pytest.raises(PathRefused, match="can be written by others"):
        authority_home.trusted(tmp_path)


def test_a_key_behind_another_module_is_refused(tmp_path: Path) -> None:
    (tmp_path / "ca").mkdir()
    (tmp_path / "ca" / authority_home.KEY_URI).write_text(f"{URI}\n")
    (tmp_path / "ca" / authority_home.KEY_URI).chmod(0o600)
    with pytest.raises(TokenRefused, match="not trusted here") as caught:
        authority_home.AuthorityHome(tmp_path / "ca").load_key("1234", {OTHER})
    assert str(tmp_path / authority_home.FILE) in caught.value.hint


def test_a_backup_does_not_say_which_module(tmp_path: Path) -> None:
    data = str(URI).encode()
    with pytest.raises(TokenRefused, match="as it says") as caught:
        authority_home.restored_uri(data, tmp_path, None)
    assert "--pkcs11-module" in caught.value.hint
    assert authority_home.restored_uri(data, tmp_path, OTHER).module == OTHER
    authority_home.trust(tmp_path, MODULE)
    assert authority_home.restored_uri(data, tmp_path, None) == URI
    with pytest.raises(TokenRefused):
        authority_home.restored_uri(b"\xff", tmp_path, MODULE)
