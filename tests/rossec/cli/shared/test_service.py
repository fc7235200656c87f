import asyncio
import time
from pathlib import Path

import click
import pytest

from rossec.authority.home import AuthorityHome
from rossec.authority.service import AuthorityService
from rossec.cli.shared import options
from rossec.cli.shared.context import Environment
from rossec.cli.shared.service import deliver_grant, pass_service, service_of
from rossec.home import NodeHome
from rossec.master.server.start import master_of
from rossec.terminal import say
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


def test_a_command_gets_the_authority_of_its_options(shell: Shell) -> None:
    @click.command()
    @options.master_uri
    @click.option("--name")
    @pass_service
    def command(service: AuthorityService, name: str) -> str:
        say(f"{service.unlock().domain} {name}")
        return "unused"

    words = ["--passphrase-file", str(shell.secret), "--name", "n", "--master", "http://m:1"]
    command.main(words, standalone_mode=False, obj=Environment(shell.environ))
    with pytest.raises(click.BadParameter, match="does not exist"):
        command.main(["--passphrase-file", "/no"], standalone_mode=False)


def test_a_grant_is_given_to_a_node_of_this_host(
    shell: Shell, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shell.enroll("/robot")
    out = tmp_path / "p.grant"
    shell.unlocked("grant", "sign", "/robot", "--publish", "/p", "--out", str(out))
    (held,) = (shell.node("/robot") / "grants").iterdir()
    held.unlink()
    service = service_of(Environment(shell.environ))
    deliver_grant(service, "/robot", out.read_bytes(), None)
    assert [file.read_bytes() for file in held.parent.iterdir()] == [out.read_bytes()]
    assert capsys.readouterr().out == f"given to /robot in {shell.node('/robot')}\n"
    deliver_grant(service, "/elsewhere", out.read_bytes(), None)
    assert "rossec grant install FILE" in capsys.readouterr().err
    copy = tmp_path / "copy"
    deliver_grant(service, "/elsewhere", out.read_bytes(), copy)
    assert copy.read_bytes() == out.read_bytes()
    assert capsys.readouterr() == (f"written to {copy}\n", "")


async def test_the_master_gets_the_revocation_of_a_replaced_key(shell: Shell) -> None:
    for name in ("/master", "/robot"):
        shell.enroll(name)
    home = NodeHome.of(shell.root, "/master")
    server = master_of(home, host="127.0.0.1", port=0, newest=None, now=int(time.time()))
    await server.start()
    try:
        shell.node("/robot").rename(shell.root / "lost")
        shell("node", "request", "/robot")
        request = str(shell.node("/robot") / "node.csr")
        replace = ("--yes", "--replace-key", "/robot", "--master", server.uri)
        said = await asyncio.to_thread(shell.unlocked, "ca", "sign", request, *replace)
        assert said.out.endswith("the replaced key is revoked\nthe master has the new list\n")
    finally:
        await server.close()
