import json
import time
from pathlib import Path

import pytest

from ca.certificates import from_pem
from rossec.authority.home import OWN_LIFETIME, AuthorityHome
from rossec.cli.ca import identities
from rossec.home import NodeHome
from tests.support.commands import Shell, refused

NOBODY = ("--master", "http://127.0.0.1:1")


def listed(shell: Shell, *options: str) -> dict[str, str]:
    said = json.loads(shell("ca", "list", "--json", *options).out)
    return {f"{row['name']} {row['serial'][:4]}": row["state"] for row in said}


def states(shell: Shell) -> list[str]:
    return [row["state"] for row in json.loads(shell("ca", "list", "--json", "--all").out)]


def test_identities_are_listed_by_state(shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    shell.enroll("/robot")
    assert sorted(name.split()[0] for name in listed(shell)) == ["/ca", "/robot"]
    shell.unlocked("ca", "renew", "/robot", "--out", str(shell.root / "new.pem"))
    assert states(shell) == ["valid", "replaced", "valid"]
    said = shell("ca", "list", "--all").out
    assert len(said.splitlines()) == 3
    assert said.count("  replaced\n") == 1
    shell.unlocked("ca", "revoke", "/robot", *NOBODY)
    assert states(shell) == ["valid", "revoked", "revoked"]
    assert [line.split()[0] for line in shell("ca", "list").out.splitlines()] == ["/ca"]
    late = int(time.time()) + OWN_LIFETIME + 10
    monkeypatch.setattr(identities, "now", lambda: late)
    assert states(shell) == ["expired", "revoked", "revoked"]
    assert shell("ca", "list").out == ""


def test_a_node_is_shown_with_all_its_identities(shell: Shell) -> None:
    shell.enroll("/robot")
    about = json.loads(shell("ca", "show", "/robot", "--json").out)
    assert (about["domain"], about["intermediate"]) == ("home", False)
    assert [row["name"] for row in about["identities"]] == ["/robot"]
    assert "/robot  until" in shell("ca", "show", "/robot").out
    assert "/ca " not in shell("ca", "show", "/robot").out
    refused(shell("ca", "show", "/nobody"), "/nobody never had an identity", "rossec ca list --all")


def test_an_identity_is_renewed_by_name(
    shell: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    shell.enroll("/robot1/camera")
    said = shell.unlocked("ca", "renew", "/robot1/camera", "--for", "10d")
    assert said.out.startswith("renewed /robot1/camera: robot1.camera.pem\n")
    assert f"installed in {shell.node('/robot1/camera')}" in said.out
    assert len(from_pem((tmp_path / "robot1.camera.pem").read_bytes())) == 2
    away = shell.node("/robot1/camera").rename(tmp_path / "away")  # the node of another machine
    said = shell.unlocked("ca", "renew", "/robot1/camera")
    assert "next, on its machine: rossec node install robot1.camera.pem" in said.out
    away.rename(shell.node("/robot1/camera"))
    assert shell("node", "install", "robot1.camera.pem", "--yes").code == 0


def test_one_that_cannot_be_installed_here_is_still_written(
    shell: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    shell.enroll("/robot")
    shell.enroll("/other")
    key = shell.node("/robot") / "node.key"
    key.write_bytes((shell.node("/other") / "node.key").read_bytes())
    said = shell.unlocked("ca", "renew", "/robot")
    assert "not installed in" in said.err
    assert "next, on its machine: rossec node install robot.pem" in said.out


def test_an_identity_that_is_over_comes_back_with_its_key(
    shell: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("/robot", "/stolen"):
        shell.enroll(name)
    shell.unlocked("ca", "revoke", "/stolen", *NOBODY)
    before = NodeHome.of(shell.root, "/robot").identity(int(time.time()))
    soon = before.not_after - 86400
    monkeypatch.setattr(identities, "now", lambda: soon)
    said = shell("ca", "list")
    assert "not renewed yet, with less than a third of their time left: /robot" in said.err
    rows = {row["name"]: row["ends_soon"] for row in json.loads(shell("ca", "list", "--json").out)}
    assert rows == {"/ca": False, "/robot": True}
    late = before.not_after + 86400
    for module in ("rossec.cli.ca.identities", "rossec.cli.shared.service"):
        monkeypatch.setattr(f"{module}.now", lambda: late)
    said = shell("ca", "list")
    assert "/robot" not in said.out
    assert "over: /robot (with key and grants back by: rossec ca renew --expired NAME)" in said.err
    assert "/stolen" not in said.err
    refused(
        shell.unlocked("ca", "renew", "/robot"),
        "the identity of /robot ended on 20",
        "rossec ca renew --expired /robot",
    )
    assert shell.unlocked("ca", "renew", "--expired", "/robot").code == 0
    after = NodeHome.of(shell.root, "/robot").identity(late)
    assert after.thumbprint == before.thumbprint
    said = shell.unlocked("ca", "renew", "--expired", "/stolen")
    refused(said, "the identity of /stolen is revoked")
    refused(shell.unlocked("ca", "renew", "--expired", "/nobody"), "has no valid identity here")


def test_the_authoritys_own_node_is_renewed_in_place(shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    before = AuthorityHome.at(shell.root).node().identity(int(time.time()))
    said = shell.unlocked("ca", "renew", "/ca")
    assert said.out.startswith("renewed /ca until 20")
    after = AuthorityHome.at(shell.root).node().identity(int(time.time()))
    assert after.serial != before.serial
    assert after.thumbprint == before.thumbprint


def test_an_unknown_name_or_an_intermediate_is_not_renewed(shell: Shell) -> None:
    refused(shell.unlocked("ca", "renew", "/nobody"), "/nobody has no valid identity here")
    refused(
        shell.unlocked("ca", "renew", "intermediate/0123"),
        "is an intermediate",
        "rossec ca intermediate sign",
    )


def test_an_expired_own_node_is_reported_and_renewed_by_refresh(
    shell: Shell, monkeypatch: pytest.MonkeyPatch
) -> None:
    late = int(time.time()) + OWN_LIFETIME + 86400
    for module in ("rossec.cli.ca.identities", "rossec.cli.shared.service"):
        monkeypatch.setattr(f"{module}.now", lambda: late)
    unlocked = AuthorityHome.at(shell.root).unlock(shell.secret.read_text().strip())
    unlocked.sign_list(late)
    refused(shell("ca", "publish", *NOBODY), "the identity of /ca has expired", "rossec ca renew /ca")
    said = shell.unlocked("ca", "refresh", *NOBODY)
    assert said.out.startswith("renewed /ca until 20")
    refused(said, "did not take the list", code=3)
