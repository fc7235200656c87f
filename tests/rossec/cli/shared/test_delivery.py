import time

from rossec.authority.home import AuthorityHome
from tests.support.commands import PASSPHRASE, Shell, refused

DAY = 86400
NOBODY = ("--master", "http://127.0.0.1:1")


def age(shell: Shell, days: int) -> None:
    """Have the newest list signed so many days ago; it holds for 90."""
    unlocked = AuthorityHome.at(shell.root).unlock(PASSPHRASE)
    unlocked.sign_list(int(time.time()) - days * DAY)


def test_an_expired_list_is_not_delivered(shell: Shell) -> None:
    age(shell, 90)
    said = shell("ca", "publish", *NOBODY)
    refused(said, "the revocation list expired", "rossec ca refresh")
    refused(shell.unlocked("ca", "refresh", *NOBODY), "did not take the list", code=3)
    refused(shell("ca", "publish", *NOBODY), "did not take the list", code=3)


def test_a_list_about_to_expire_is_reported(shell: Shell) -> None:
    age(shell, 84)
    said = shell("ca", "publish", *NOBODY)
    assert said.err.startswith("rossec: the revocation list expires 20")
    assert said.err.splitlines()[0].endswith("renew it with: rossec ca refresh")
    assert said.code == 3
    age(shell, 82)
    refused(shell("ca", "publish", *NOBODY), "did not take the list", code=3)


def test_a_list_signed_along_with_something_is_reported(shell: Shell) -> None:
    age(shell, 84)
    shell("node", "request", "/robot")
    sign = ("ca", "sign", str(shell.node("/robot") / "node.csr"), "--yes")
    grant = ("grant", "sign", "/robot", "--publish", "/p")
    for command in (sign, grant):
        age(shell, 84)
        said = shell.unlocked(*command)
        assert said.code == 0
        assert "is signed anew; deliver it with: rossec ca publish" in said.err
        assert "deliver it" not in shell.unlocked(*command).err
