"""Transcripts of commands over several names: one unlawful entry does not fail the others."""

import json
import time
from pathlib import Path
from typing import Any

import pytest

from grants.model import Draft, Permission, Right
from rossec.authority.home import AuthorityHome
from tests.support.commands import PASSPHRASE, Said, Shell, refused

NOBODY = ("--master", "http://127.0.0.1:1")


def entries(said: Said) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = json.loads(said.out)["results"]
    return found


def outcomes(said: Said) -> list[bool]:
    return [entry["ok"] for entry in entries(said)]


def test_requests_are_signed_and_installed_together(
    shell: Shell, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    said = shell("node", "request", "/a", "bad name", "/b/c")
    assert said.code == 1
    assert "rossec: error: bad name: " in said.err
    assert said.err.splitlines()[-2:] == ["rossec: error: 1 of 3 were refused", "rossec: hint: see above"]
    requests = [str(shell.node(name) / "node.csr") for name in ("/a", "/b/c")]
    *lines, last = said.out.splitlines()
    assert [line for line in lines if line.startswith("request of")] == [
        f"request of /a: {requests[0]}",
        f"request of /b/c: {requests[1]}",
    ]
    assert last == f"next, at the authority: rossec ca sign {' '.join(requests)}"

    again = shell("node", "request", "/a", "/d", "--json")
    assert again.code == 1
    assert [entry["name"] for entry in entries(again)] == ["/a", "/d"]
    assert outcomes(again) == [False, True]
    assert "has a key already" in entries(again)[0]["error"]

    (odd := tmp_path / "odd.csr").write_bytes(b"nothing")
    signed = shell.unlocked("ca", "sign", *requests, str(odd), "--yes", "--json")
    assert signed.code == 1
    assert outcomes(signed) == [True, True, False]
    bundles = [entry["identity"] for entry in entries(signed) if entry["ok"]]
    installed = shell("node", "install", *bundles, str(odd), "--yes")
    assert installed.code == 1
    assert [line for line in installed.out.splitlines() if "is enrolled" in line] == [
        "/a is enrolled in home",
        "/b/c is enrolled in home",
    ]
    assert installed.out.count("fingerprint") == 1, "one authority, one question"
    assert f"error: {odd}: " in installed.err

    renewed = shell.unlocked("ca", "renew", "/a", "/nobody", "/b/c", "/ca")
    assert renewed.code == 1
    assert "error: /nobody: " in renewed.err
    assert "renewed /a: a.pem" in renewed.out
    assert "renewed /ca until " in renewed.out
    assert f"installed in {shell.node('/a')}" in renewed.out
    for name in ("/a", "/b/c"):
        shell.node(name).rename(tmp_path / name.replace("/", "-"))  # nodes of other machines
    renewed = shell.unlocked("ca", "renew", "/a", "/b/c")
    assert "next, on their machines: rossec node install a.pem b.c.pem" in renewed.out
    for name in ("/a", "/b/c"):
        (tmp_path / name.replace("/", "-")).rename(shell.node(name))
    for file in ("a.pem", "b.c.pem"):
        assert shell("node", "install", file, "--yes").code == 0


def test_one_name_says_what_it_always_said(
    shell: Shell, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    shell.enroll("/robot")
    renewed = shell.unlocked("ca", "renew", "/robot").out.splitlines()
    assert renewed == ["renewed /robot: robot.pem", f"installed in {shell.node('/robot')}"]
    refused(shell.unlocked("ca", "renew", "/nobody"), "/nobody")
    refused(shell.unlocked("ca", "renew", "/a", "/b", "--out", "x"), "--out is of one", code=2)
    refused(shell("node", "request"), "give NAME, or --meta FILE", code=2)
    refused(shell("node", "request", "/robot"), "/robot has a key already")


def test_identities_are_revoked_together_and_the_master_is_told_once(shell: Shell) -> None:
    for name in ("/a", "/b"):
        shell.enroll(name)
    said = shell.unlocked("ca", "revoke", "/a", "/nobody", "/b", "/a", "--json", *NOBODY)
    assert said.code == 3, "what was revoked is not delivered: that comes first"
    assert [entry["name"] for entry in entries(said)] == ["/a", "/nobody", "/b"]
    assert outcomes(said) == [True, False, True]
    assert entries(said)[0]["keys"] == 1
    found = json.loads(said.out)
    assert found["published"] is False
    assert "did not take the list" in found["error"]
    assert said.err.count("did not take the list") == 1
    nothing = shell.unlocked("ca", "revoke", "/x", "/y", *NOBODY)
    refused(nothing, "/x")
    assert "did not take" not in nothing.err, "nothing was revoked, nothing is delivered"
    both = shell.unlocked("ca", "revoke", "/a", "/b", "--certificate", str(shell.secret))
    refused(both, "--certificate is of one NAME", code=2)


def test_a_wrong_passphrase_is_said_once(shell: Shell, tmp_path: Path) -> None:
    (wrong := tmp_path / "wrong").write_text("not the words of it\n")
    wrong.chmod(0o600)
    for words in (("ca", "revoke"), ("ca", "renew"), ("grant", "revoke"), ("ca", "approve")):
        said = shell(*words, "/a", "/b", "--passphrase-file", str(wrong))
        assert said.code == 1
        assert said.err.count("rossec: error: ") == 1, said.err


def test_grants_are_revoked_together(shell: Shell) -> None:
    shell.enroll("/robot")
    signed = [
        json.loads(shell.unlocked("grant", "sign", "/robot", "--publish", f"/t{n}", "--json").out)
        for n in range(2)
    ]
    assert signed[0]["node"] == "/robot"
    assert [Path(each["path"]).exists() for each in signed[0]["given"]] == [True]
    ids = [each["id"] for each in signed]
    said = shell.unlocked("grant", "revoke", ids[0][:8], "ffff", ids[1], "--json", *NOBODY)
    assert said.code == 3
    assert outcomes(said) == [True, False, True]
    assert [entry.get("grant") for entry in entries(said)] == [ids[0], None, ids[1]]


def test_requests_for_an_identity_are_answered_together(shell: Shell) -> None:
    for name in ("/a", "/b", "/c"):
        assert shell("node", "request", name).code == 0
        csr = str(shell.node(name) / "node.csr")
        assert shell("ca", "enroll", "--csr", csr, "--later").code == 0
    waiting = {row["name"]: row["request"] for row in json.loads(shell("ca", "requests", "--json").out)}
    said = shell.unlocked("ca", "approve", waiting["/a"][:8], "abcdef", waiting["/b"], "--json")
    assert said.code == 1
    assert [(entry.get("name"), entry["ok"]) for entry in entries(said)] == [
        ("/a", True),
        (None, False),
        ("/b", True),
    ]
    said = shell("ca", "deny", waiting["/c"], "zz", "--reason", "a test")
    assert said.code == 1
    assert said.out == "denied /c\n"
    assert "error: zz: 'zz' is not a request id" in said.err


def test_the_list_of_grants_is_sorted_and_says_state_and_end(shell: Shell) -> None:
    for name in ("/zebra", "/ape"):
        shell.enroll(name)
    for name, lasts in (("/zebra", "1d"), ("/ape", "1d"), ("/ape", "9d"), ("/ape", "5d")):
        shell.unlocked("grant", "sign", name, "--publish", "/x", "--for", lasts)
    _expired(shell, "/ape")
    rows = json.loads(shell("grant", "list", "--json", *NOBODY).out)
    shell.unlocked("grant", "revoke", rows[0]["id"], *NOBODY)
    lines = shell("grant", "list", *NOBODY).out.splitlines()
    assert [(line.split("  ")[1], line.rsplit("  ", 1)[1]) for line in lines] == [
        ("/ape", "delivered"),
        ("/ape", "delivered"),
        ("/ape", "revoked"),
        ("/ape", "expired"),
        ("/zebra", "delivered"),
    ]
    assert lines[2].startswith(rows[0]["id"])
    assert all(line[32:34] == "  " and " until " in line for line in lines), "README cuts the id"
    both = shell("grant", "list", "/zebra", "/ape", *NOBODY).out.splitlines()
    assert both == lines
    assert len(shell("grant", "list", "/zebra", *NOBODY).out.splitlines()) == 1
    of_ape = [row["expires"] for row in rows if row["node"] == "/ape" and row["state"] != "expired"]
    assert of_ape == sorted(of_ape, reverse=True)


def _expired(shell: Shell, name: str) -> None:
    home, at = AuthorityHome.at(shell.root), int(time.time())
    key = json.loads(shell("ca", "show", name, "--json").out)["identities"][0]["key"]
    authority = home.unlock(PASSPHRASE)
    draft = Draft(
        domain="home",
        subject=name,
        holder=bytes.fromhex(key),
        not_before=at - 60,
        expires=at - 10,
        cap=at - 10,
        serial=b"s" * 16,
        permissions=(Permission("/old", Right.PUBLISH, None),),
    )
    authority.issue_grant(draft, at - 50)
    authority.store.close()
