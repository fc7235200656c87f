import asyncio
import re
import time
from pathlib import Path

import click
import pytest

from ca.certificates import Identity
from rossec.authority.grant_operations import RefusedDeposit
from rossec.authority.home import AuthorityHome
from rossec.authority.service import AuthorityService
from rossec.authority.session import StatementCall
from rossec.cli.shared import options
from rossec.cli.shared.context import Environment
from rossec.cli.shared.service import call_master, deliver_grant, pass_service, say_deposited, service_of
from rossec.errors import NotDelivered
from rossec.home import NodeHome
from rossec.master.server.server import master_of
from rossec.net.aio import SecureContext, SecureStream, WireProtocol, serve
from rossec.net.rpc.calls import serve_calls
from rossec.ros.xmlrpc import Fault
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
    service = service_of(Environment(shell.environ), master_uri=NOBODY[1])
    deliver_grant(service, out.read_bytes(), None)
    assert [file.read_bytes() for file in held.parent.iterdir()] == [out.read_bytes()]
    given = f"given to /robot in {shell.node('/robot')}\n"
    assert capsys.readouterr() == (given, ""), "no master is needed"
    shell.node("/robot").rename(shell.root / "elsewhere")
    deliver_grant(service, out.read_bytes(), None)
    said = capsys.readouterr().err
    assert "the master at http://127.0.0.1:1 did not take the grant" in said
    assert said.endswith("deliver it when the master runs: rossec grant deliver\n")
    copy = tmp_path / "copy"
    deliver_grant(service, out.read_bytes(), copy)
    assert copy.read_bytes() == out.read_bytes()
    assert capsys.readouterr() == (f"written to {copy}\n", ""), "somebody carries it"


def test_deposits_are_reported_with_what_the_master_refuses(capsys: pytest.CaptureFixture[str]) -> None:
    say_deposited(1, [])
    say_deposited(0, [RefusedDeposit(bytes(16), "/robot", "too many grants")])
    say_deposited(30, [])
    said = capsys.readouterr()
    assert said.out.splitlines() == [
        "the master has the grant, and gives it to the node",
        "the master has 30 grants, and gives them to the nodes",
    ]
    assert said.err == "rossec: the master refuses the grant 00000000 of /robot: too many grants\n"


class Answers:
    """A peer that answers every call the same way."""

    def __init__(self, value: object) -> None:
        self.value = value

    async def __call__(self, method: str, params: tuple[object, ...], peer: Identity) -> object:
        if isinstance(self.value, Exception):
            raise self.value
        if self.value is None:
            await asyncio.Event().wait()
        return [1, "", self.value]


@pytest.mark.parametrize(
    ("value", "outcome"),
    [
        (["", "full"], ["", "full"]),
        (Fault(1, "method is not supported"), "is it of an older version?"),
        (None, "no answer in time"),
    ],
)
async def test_a_call_at_the_master_has_a_value_or_a_reason(
    shell: Shell, value: object, outcome: object
) -> None:
    shell.enroll("/master")
    home, node = NodeHome.of(shell.root, "/master"), AuthorityHome.at(shell.root).node()
    own = SecureContext(home.credentials(), home.anchor().verify)

    async def handle(stream: SecureStream[Identity]) -> None:
        await serve_calls(stream, Answers(value))

    async with serve(handle, "127.0.0.1", 0, own, WireProtocol.HTTP) as server:
        call = StatementCall(node, "a.method", ([b"x"],), "the grants", "later", within=0.5)
        uri = f"http://127.0.0.1:{server.port}"
        made = asyncio.to_thread(call_master, Environment(shell.environ), uri, call)
        if isinstance(outcome, str):
            with pytest.raises(NotDelivered, match=re.escape(outcome)):
                await made
        else:
            assert await made == outcome


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
