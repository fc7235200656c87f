"""What an intermediate signed becomes known at the root, which then can grant and revoke."""

import shutil
import time
from pathlib import Path

import pytest

from rossec.authority.home import AuthorityHome
from rossec.home import NodeHome
from tests.rossec.cli.ca.test_intermediate import NOBODY, installed
from tests.support.commands import Shell, refused
from tests.vectors.make_things import KEY

GRANT = ("grant", "sign", "/robot", "--publish", "/p", "--out")


@pytest.fixture
def host(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Shell:
    """The machine of the intermediate."""
    return Shell(tmp_path / "host", capsys)


def carried(host: Shell, shell: Shell, name: str = "/robot", to: str = "robot.pem") -> str:
    shutil.copy(host.node(name) / "node.pem", shell.root / to)
    return str(shell.root / to)


def test_a_node_of_an_intermediate_is_given_a_grant_by_the_root(
    shell: Shell, host: Shell, tmp_path: Path
) -> None:
    installed(shell, host)
    host.enroll("/robot")
    out = str(tmp_path / "robot.grant")
    said = shell.unlocked(*GRANT, out)
    refused(said, "/robot has no valid identity here", "rossec ca import NODE.pem")
    said = shell.unlocked("ca", "import", carried(host, shell), "--yes")
    assert said.code == 0
    assert said.out.endswith("imported /robot\n")
    assert "  signed by intermediate/" in said.out
    assert shell.unlocked(*GRANT, out).code == 0
    assert host("grant", "install", out).code == 0
    assert shell("ca", "log", "verify").code == 0
    assert "  imported  /robot" in shell("ca", "log").out
    again = shell.unlocked("ca", "import", carried(host, shell), "--yes")
    assert (again.code, again.out.splitlines()[-1]) == (0, "known already: /robot")
    assert "revoked /robot, 1 key" in shell.unlocked("ca", "revoke", "/robot", *NOBODY).out
    said = shell.unlocked("ca", "import", carried(host, shell), "--yes")
    refused(said, "the key of /robot is revoked")


def test_what_is_refused_does_not_fail_the_rest(shell: Shell, host: Shell) -> None:
    installed(shell, host)
    for name in ("/robot", "/other"):
        host.enroll(name)
    shell.enroll("/other")  # the root knows it, with another key, as a router of things
    ccs = shell.root / "lamp.ccs"
    ccs.write_bytes(KEY.ccs)
    thing = ("ca", "thing", "/things/lamp", "--border", "/other", "--key", str(ccs), "--yes")
    assert shell.unlocked(*thing, "--out", str(shell.root / "lamp.thing")).code == 0
    garbage = shell.root / "garbage.pem"
    garbage.write_bytes(b"garbage")
    files = [carried(host, shell, "/other", "other.pem"), str(garbage), carried(host, shell)]
    said = shell.unlocked("ca", "import", *files, "--yes")
    assert said.code == 1
    assert "imported /robot" in said.out
    assert f"rossec: error: {garbage}: " in said.err
    assert f"{files[0]}: /other has an identity with another key" in said.err
    assert "2 of 3 were refused" in said.err
    said = shell.unlocked("ca", "import", files[0], "--replace-key", "/other", "--yes", *NOBODY)
    assert said.code == 3  # signed and kept; there is no master
    assert "imported /other\nthe replaced key is revoked\n" in said.out
    assert shell("ca", "things", "--all").out.endswith("  revoked\n")
    key = NodeHome.of(host.root, "/other").identity(int(time.time())).thumbprint
    assert AuthorityHome.at(shell.root).store().unrevoked_keys("/other", int(time.time())) == {key}


def test_a_revoked_or_unknown_intermediate_vouches_for_nobody(
    shell: Shell, host: Shell, tmp_path: Path
) -> None:
    backup = str(tmp_path / "backup")
    assert shell.unlocked("ca", "backup", backup).code == 0
    name = installed(shell, host)
    host.enroll("/robot")
    bundle = carried(host, shell)
    assert shell.unlocked("ca", "revoke", name, *NOBODY).code == 3
    said = shell.unlocked("ca", "import", bundle, "--yes")
    refused(said, "the key of the intermediate of /robot is revoked")
    (shell.root / "ca").rename(shell.root / "lost")
    said = shell.unlocked("ca", "restore", backup, "--without-list")
    assert said.code == 0, said
    said = shell.unlocked("ca", "import", bundle, "--yes")
    refused(said, "the intermediate of /robot is not in this record", "make a new intermediate")


def test_only_a_root_imports_and_never_its_own_node(shell: Shell, host: Shell) -> None:
    installed(shell, host)
    host.enroll("/robot")
    said = host.unlocked("ca", "import", carried(host, host), "--yes")
    refused(said, "/robot cannot be imported here", "only a root imports")
    own = str(shell.root / "ca" / "node" / "node.pem")
    refused(shell.unlocked("ca", "import", own, "--yes"), "/ca cannot be imported here")


def test_the_root_renews_what_it_imported(shell: Shell, host: Shell) -> None:
    name = installed(shell, host)
    host.enroll("/robot")
    assert shell.unlocked("ca", "import", carried(host, shell), "--yes").code == 0
    before = NodeHome.of(host.root, "/robot").identity(int(time.time()))
    out = str(shell.root / "renewed.pem")
    said = shell.unlocked("ca", "renew", "/robot", "--out", out)
    assert said.code == 0, said
    assert host("node", "install", out, "--yes").code == 0
    after = NodeHome.of(host.root, "/robot").identity(int(time.time()))
    assert (after.keys, len(before.keys)) == ((before.thumbprint,), 2)  # the root's own, same key
    assert shell.unlocked("ca", "revoke", name, *NOBODY).code == 3
    assert "/robot  until" in shell("ca", "list").out
    assert shell.unlocked("ca", "renew", "/robot", "--out", out).code == 0


def test_what_a_revoked_intermediate_signed_is_alive_no_longer(
    shell: Shell, host: Shell, tmp_path: Path
) -> None:
    name = installed(shell, host)
    host.enroll("/robot")
    shell.enroll("/other")  # by the root itself: it stays
    assert shell.unlocked("ca", "import", carried(host, shell), "--yes").code == 0
    assert "/robot  until" in shell("ca", "list").out
    assert shell.unlocked("ca", "revoke", name, *NOBODY).code == 3
    listed = shell("ca", "list").out
    assert "/robot" not in listed
    assert "/other  until" in listed
    assert shell("ca", "show", "/robot").out.splitlines()[-1].endswith("  revoked")
    said = shell.unlocked(*GRANT, str(tmp_path / "robot.grant"))
    hint = "enroll it again: rossec node request /robot"
    refused(said, "the intermediate that signed the identity of /robot is revoked", hint)
    refused(shell.unlocked("ca", "renew", "/robot"), "the intermediate that signed", hint)
    shell.enroll("/robot")  # with a new key, which takes nothing from anybody
    assert shell.unlocked(*GRANT, str(tmp_path / "robot.grant")).code == 0
    # What the intermediate vouched for can be revoked still: a grant may be for that key.
    key = NodeHome.of(host.root, "/robot").identity(int(time.time())).thumbprint
    assert "revoked /robot, 2 keys" in shell.unlocked("ca", "revoke", "/robot", *NOBODY).out
    assert key in AuthorityHome.at(shell.root).store().revoked_entries()
