import asyncio
from pathlib import Path

import pytest

from rossec import clock
from rossec.authority.home import OWN_LIFETIME, AuthorityHome
from rossec.authority.service import Identities
from rossec.home import NodeHome
from rossec.master.server.server import master_of
from tests.rossec.cli.ca.record import key_of, listed
from tests.support.commands import Shell, refused

REVOKE = ("ca", "revoke", "/robot", "--reason", "stolen", "--master", "http://127.0.0.1:1")


def test_an_identity_can_be_revoked(shell: Shell) -> None:
    shell.enroll("/robot")
    said = shell.unlocked(*REVOKE)
    assert said.out == "revoked /robot, 1 key (list 2)\n"
    refused(said, "did not take the list", "rossec ca publish", code=3)
    assert listed(shell) == {key_of(shell, "/robot")}
    refused(shell.unlocked(*REVOKE), "/robot has no valid identity to revoke", "rossec ca show")
    grant = ("grant", "sign", "/robot", "--publish", "/p")
    refused(shell.unlocked(*grant), "the identity of /robot is revoked", "rossec node request")
    request = str(shell.node("/robot") / "node.csr")
    refused(shell.unlocked("ca", "sign", request, "--yes"), "key of /robot is revoked", "new key")
    shell.node("/robot").rename(shell.root / "old")
    shell.enroll("/robot")


def test_an_unknown_or_invalid_name_is_not_revoked(shell: Shell) -> None:
    refused(shell.unlocked("ca", "revoke", "/nobody"), "/nobody has no valid identity")
    refused(shell.unlocked("ca", "revoke", "robot"), "not an absolute ROS name", "/robot")
    refused(shell.unlocked("ca", "revoke", "/ca"), "the authority's own node", "create a new one")
    assert listed(shell) == frozenset()


def test_a_list_is_not_delivered_without_a_master(shell: Shell) -> None:
    said = shell("ca", "publish", "--master", "http://127.0.0.1:1")
    refused(said, "did not take the list", "rossec ca publish", code=3)
    refused(shell("ca", "publish", "--master", "127.0.0.1"), "does not begin with http://")


def test_a_list_can_be_signed_anew(shell: Shell) -> None:
    said = shell.unlocked("ca", "refresh", "--master", "http://127.0.0.1:1")
    assert said.out.startswith("list 2 holds until ")
    refused(said, "did not take the list", "rossec ca publish", code=3)


def test_an_anonymous_node_is_revoked_with_its_identity(shell: Shell) -> None:
    shell("node", "request", "/rviz")
    request = str(shell.node("/rviz") / "node.csr")
    shell.unlocked("ca", "sign", request, "--yes", "--anonymous")
    revoke = ("ca", "revoke", "/rviz_17", "--master", "http://127.0.0.1:1")
    refused(shell.unlocked(*revoke), "/rviz_17 has no valid", "nodes of /rviz: revoking that revokes")


def test_a_revocation_in_no_list_is_signed_before_it_is_delivered(shell: Shell) -> None:
    AuthorityHome.at(shell.root).store().revoke(b"k" * 32, "then it was killed", clock.now())
    said = shell.unlocked("ca", "publish", "--master", "http://127.0.0.1:1")
    assert said.err.startswith("rossec: 1 revocation in no signed list yet")
    assert listed(shell) == {b"k" * 32}
    assert AuthorityHome.at(shell.root).count_unlisted(clock.now()) == 0


def test_the_authoritys_own_node_is_renewed_when_due(shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    due = clock.now() + OWN_LIFETIME * 3 // 4
    monkeypatch.setattr(clock, "now", lambda: due)
    said = shell.unlocked("ca", "refresh", "--master", "http://127.0.0.1:1")
    assert said.out.splitlines()[0].startswith("renewed /ca until ")


async def test_a_master_takes_the_newest_list(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shell = Shell(tmp_path / "home", capsys)
    shell.unlocked("ca", "init", "home")
    shell.enroll("/master")
    home = NodeHome.of(shell.root, "/master")
    newest = AuthorityHome.at(shell.root).revocation_list()
    server = master_of(home, host="127.0.0.1", port=0, newest=newest, now=clock.now())
    await server.start()
    shell.environ["ROS_MASTER_URI"] = server.uri
    try:
        said = await asyncio.to_thread(shell, "ca", "publish")
        assert (said.code, said.out) == (0, "the master has the newest list\n")
    finally:
        await server.close()


def test_what_a_list_from_before_a_restore_revokes_is_taken_over(shell: Shell) -> None:
    shell.enroll("/robot")
    assert shell.unlocked(*REVOKE).code == 3
    home = AuthorityHome.at(shell.root)
    (shell.root / "held.cbor").write_bytes(home.revocation_list())
    key = key_of(shell, "/robot")
    refresh = ("ca", "refresh", "--list", str(shell.root / "held.cbor"), *REVOKE[-2:])
    said = shell.unlocked(*refresh)
    assert f"0 revocations were taken over from {shell.root / 'held.cbor'}\n" in said.out
    assert listed(shell) == {key}


def test_several_are_revoked_and_one_that_cannot_be_stops_none(shell: Shell) -> None:
    for name in ("/robot", "/lamp"):
        shell.enroll(name)
    said = shell.unlocked("ca", "revoke", "/robot", "/nobody", "/lamp", *REVOKE[-2:])
    assert "revoked /robot, 1 key" in said.out
    assert "revoked /lamp, 1 key" in said.out
    assert "/nobody has no valid identity" in said.err
    assert listed(shell) == {key_of(shell, "/robot"), key_of(shell, "/lamp")}
    pem = ("--certificate", str(shell.node("/robot") / "node.pem"))
    assert shell.unlocked("ca", "revoke", "/robot", "/lamp", *pem).code == 2
    refused(shell.unlocked("ca", "revoke", "/robot", *pem), "/robot is a node of this domain", "LABEL:")


def test_keys_that_an_intermediate_may_have_certified_are_spoken_of(
    shell: Shell, monkeypatch: pytest.MonkeyPatch
) -> None:
    shell.enroll("/robot")
    monkeypatch.setattr(Identities, "intermediates", lambda _: ["intermediate:0123"])
    said = shell.unlocked(*REVOKE)
    assert "intermediate:0123 may have certified other keys for /robot" in said.err
    assert "or revoke intermediate:0123" in said.err
