"""An authority whose key is in a real SoftHSM2 token, from the command line."""

from pathlib import Path

import pytest

from rossec.authority.home import AuthorityHome
from tests.support.commands import Shell, refused
from tests.support.token import PIN, softhsm

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
    assert token.unlocked("ca", "restore", backup, "--over", "home").code == 0
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("ca.keys.hsm.TokenSigner.open", None)  # nothing but `init` makes keys
        refused(token.unlocked("ca", "init", "home", "--key", URI), "there is an authority")


def test_an_invalid_key_uri_is_refused(token: Shell) -> None:
    refused(token.unlocked("ca", "init", "home", "--key", "yubikey"), "does not name a key")
    init = ("ca", "init", "home", "--key", "pkcs11:token=none;object=x")
    refused(token.unlocked(*init), "there is no token none")
    assert not (token.root / "ca").exists()
