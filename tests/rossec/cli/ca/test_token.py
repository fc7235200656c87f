"""An authority whose key is in a real SoftHSM2 token, from the command line."""

from pathlib import Path

import pytest

from rossec.authority.home import FILE, AuthorityHome
from tests.support.commands import Shell, refused
from tests.support.token import MODULE, PIN, softhsm

NOBODY = ("--master", "http://127.0.0.1:1")
URI = "pkcs11:token=home;object=authority"


@pytest.fixture
def token(empty: Shell) -> Shell:
    softhsm()
    empty.secret.write_text(PIN + "\n")
    return empty


def test_the_whole_life_of_an_authority(token: Shell, tmp_path: Path) -> None:
    assert token.unlocked("ca", "init", "home", "--key", URI).code == 0
    home = AuthorityHome.at(token.root)
    assert not (home.path / "ca.key").exists()
    assert (home.path / "ca.uri").read_text().startswith(URI)
    token.enroll("/robot")
    assert token.unlocked("ca", "revoke", "/robot", *NOBODY).code == 3
    assert token("ca", "log", "verify").code == 0
    backup = str(tmp_path / "backup")
    assert token.unlocked("ca", "backup", backup).code == 0
    assert token.unlocked("ca", "restore", backup, "--without-list", "--over", "home").code == 0
    assert (token.root / FILE).read_text() == f"{MODULE}\n"
    elsewhere = Shell(tmp_path / "elsewhere", token._capsys)
    elsewhere.secret.write_text(PIN + "\n")
    anew = ("ca", "restore", backup, "--without-list")
    refused(elsewhere.unlocked(*anew), "as it says", "--pkcs11-module")
    assert elsewhere.unlocked(*anew, "--pkcs11-module", MODULE).code == 0
    assert elsewhere.unlocked("ca", "refresh", *NOBODY).code == 3
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("ca.keys.private_keys.TokenSigner.open", None)  # nothing but `init` makes keys
        refused(token.unlocked("ca", "init", "home", "--key", URI), "there is an authority")


def test_an_invalid_key_uri_is_refused(token: Shell) -> None:
    refused(token.unlocked("ca", "init", "home", "--key", "yubikey"), "does not name a key")
    init = ("ca", "init", "home", "--key", "pkcs11:token=none;object=x")
    refused(token.unlocked(*init), "there is no token none")
    assert not (token.root / "ca").exists()


def test_a_home_that_records_no_module_trusts_none(token: Shell) -> None:
    assert token.unlocked("ca", "init", "old", "--key", f"{URI}-old").code == 0
    (token.root / FILE).unlink()
    refused(token.unlocked("ca", "refresh", *NOBODY), "a module that is not trusted here", "if you know it")
    assert not (token.root / FILE).exists()


def test_a_module_is_named_from_the_root(token: Shell) -> None:
    init = ("ca", "init", "home", "--key", f"{URI}-x?module-path=./libsofthsm2.so")
    refused(token.unlocked(*init), "not the absolute path of a PKCS#11 module")
