from pathlib import Path

import pytest

from ca.errors import PathRefused, TokenRefused
from ca.keys.hsm import KeyUri
from rossec.authority import token_modules
from rossec.errors import ConfigurationError

MODULE, OTHER = "/usr/lib/a.so", "/usr/lib/b.so"
URI = KeyUri("home", "authority", MODULE)


def test_none_is_trusted_until_one_is_named(tmp_path: Path) -> None:
    home = tmp_path / "home"
    assert (token_modules.trusted(home), token_modules.exists(home)) == (frozenset(), False)
    for _ in range(2):
        token_modules.trust(home, MODULE)
        token_modules.trust(home, OTHER)
    assert token_modules.trusted(home) == {MODULE, OTHER}
    file = home / token_modules.FILE
    assert file.read_text() == f"{MODULE}\n{OTHER}\n"
    assert file.stat().st_mode & 0o777 == 0o600


@pytest.mark.parametrize("module", ["a.so", "./a.so", "", "/a\n/b", "../a.so"])
def test_only_an_absolute_path_is_one_file(tmp_path: Path, module: str) -> None:
    with pytest.raises(TokenRefused, match="not the absolute path"):
        token_modules.trust(tmp_path, module)
    with pytest.raises(TokenRefused, match="not the absolute path"):
        token_modules.restored_uri(str(URI).encode(), tmp_path, module)
    assert not token_modules.exists(tmp_path)


def test_the_file_is_its_owners_and_text(tmp_path: Path) -> None:
    file = tmp_path / token_modules.FILE
    file.write_bytes(b"\xff\n")
    with pytest.raises(ConfigurationError, match="is not UTF-8"):
        token_modules.trusted(tmp_path)
    file.write_text(f"# by hand\n{MODULE}\nrelative.so\n\n")
    assert token_modules.trusted(tmp_path) == {MODULE}
    file.chmod(0o666)
    with pytest.raises(PathRefused, match="can be written by others"):
        token_modules.trusted(tmp_path)


def test_a_key_behind_another_module_is_refused(tmp_path: Path) -> None:
    assert token_modules.require(URI, {MODULE}, tmp_path) == URI
    with pytest.raises(TokenRefused, match="not trusted here") as caught:
        token_modules.require(URI, {OTHER}, tmp_path)
    assert str(tmp_path / token_modules.FILE) in caught.value.hint


def test_a_backup_does_not_say_which_module(tmp_path: Path) -> None:
    data = str(URI).encode()
    with pytest.raises(TokenRefused, match="as it says") as caught:
        token_modules.restored_uri(data, tmp_path, None)
    assert "--pkcs11-module" in caught.value.hint
    assert token_modules.restored_uri(data, tmp_path, OTHER).module == OTHER
    token_modules.trust(tmp_path, MODULE)
    assert token_modules.restored_uri(data, tmp_path, None) == URI
    with pytest.raises(TokenRefused):
        token_modules.restored_uri(b"\xff", tmp_path, MODULE)
