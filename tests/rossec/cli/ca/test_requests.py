import json
from pathlib import Path

from rossec.authority.home import AuthorityHome
from tests.support.commands import Shell, refused


def asked(shell: Shell, name: str = "/robot") -> str:
    """A request that waits; its id."""
    shell("node", "request", name)
    said = shell("ca", "enroll", "--csr", str(shell.node(name) / "node.csr"), "--later")
    assert said.code == 0, said.err
    return said.out.split("rossec ca approve ")[1].split(",")[0]


def test_without_requests_none_are_listed(shell: Shell) -> None:
    assert shell("ca", "requests").out == "no open requests\n"
    assert shell("ca", "requests", "--json").out == "[]\n"
    assert "/ca" in shell("ca", "requests", "--all").out


def test_open_requests_are_listed(shell: Shell) -> None:
    request_id = asked(shell)
    lines = shell("ca", "requests").out.splitlines()
    assert lines[0] == f"{request_id}  pending  /robot  a file"
    assert lines[1].startswith("  fingerprint ")
    (row,) = json.loads(shell("ca", "requests", "--json").out)
    assert row["request"].startswith(request_id)
    assert (row["name"], row["state"], row["source"]) == ("/robot", "pending", "a file")


def test_an_approved_request_is_signed(shell: Shell, tmp_path: Path) -> None:
    request_id = asked(shell)
    out = tmp_path / "robot.pem"
    said = shell.unlocked("ca", "approve", request_id, "--out", str(out))
    assert said.code == 0, said.err
    assert said.out.startswith("spiffe://home/robot asks for an identity\n")
    assert f"approved /robot\nsigned: {out}; at the node: rossec node install" in said.out
    assert shell("node", "install", str(out), "--yes").code == 0
    refused(shell.unlocked("ca", "approve", request_id, "--out", str(out)), "not overwritten")
    refused(shell("ca", "deny", request_id), "is issued and cannot be denied")
    said = shell.unlocked("ca", "approve", request_id)
    assert "enrolled with this key until" in said.out


def test_a_request_that_was_approved_before(shell: Shell) -> None:
    request_id = asked(shell)
    home = AuthorityHome.at(shell.root)
    row = home.store().requests.get(bytes.fromhex(request_id))
    home.store().requests.approve(row.digest, row.changed)
    said = shell.unlocked("ca", "approve", request_id)
    assert said.code == 0
    assert "the request was approved " in said.out


def test_a_denied_request_is_closed(shell: Shell) -> None:
    request_id = asked(shell)
    assert shell("ca", "deny", request_id, "--reason", "unknown").out == "denied /robot\n"
    refused(shell.unlocked("ca", "approve", request_id), "is denied", "new request")
    (row,) = [
        row for row in json.loads(shell("ca", "requests", "--all", "--json").out) if row["name"] == "/robot"
    ]
    assert (row["state"], row["reason"]) == ("denied", "unknown")


def test_an_unknown_request_is_refused(shell: Shell) -> None:
    for command in ("approve", "deny"):
        refused(shell("ca", command, "xx"), "'xx' is not a request id", "rossec ca requests")
        refused(shell("ca", command, "ffff"), "0 requests begin", "rossec ca requests")
        refused(shell("ca", command, ""), "requests begin with", "rossec ca requests")


def test_another_key_needs_replace_key(shell: Shell) -> None:
    shell.enroll("/robot")
    shell.node("/robot").rename(shell.root / "lost")
    request_id = asked(shell)
    refused(shell.unlocked("ca", "approve", request_id), "another key", "--replace-key /robot")
    replace = ("--replace-key", "/robot", "--master", "http://127.0.0.1:1")
    said = shell.unlocked("ca", "approve", request_id, *replace)
    assert "WARNING: /robot is enrolled with ANOTHER KEY" in said.out
    refused(said, "did not take the list", "rossec ca publish", code=3)


def test_the_master_gets_the_revocation_of_a_replaced_key(shell: Shell, monkeypatch: object) -> None:
    shell.enroll("/robot")
    shell.node("/robot").rename(shell.root / "lost")
    request_id = asked(shell)
    import pytest

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("rossec.cli.shared.service.call_master", lambda *_: None)
        said = shell.unlocked("ca", "approve", request_id, "--replace-key", "/robot")
    assert said.out.endswith("the replaced key is revoked\nthe master has the new list\n")


def test_a_request_is_approved_for_anonymous_nodes(shell: Shell) -> None:
    request_id = asked(shell, "/rviz")
    said = shell.unlocked("ca", "approve", request_id, "--anonymous")
    assert "under every name that begins with /rviz_" in said.out


def test_every_digit_of_a_beginning_counts(shell: Shell) -> None:
    """What is no beginning of an id approves nothing, also where only the last digit differs."""
    asked(shell)
    store = AuthorityHome.at(shell.root).store()
    (row,), all_ids = store.requests.open(), [each.digest.hex() for each in store.requests.all()]
    request_id = row.digest.hex()
    for size in (1, 2, 3, 4, 5, 63, 64):
        tried = (request_id[: size - 1] + digit for digit in "0123456789abcdef")
        wrong = next(each for each in tried if not any(id_.startswith(each) for id_ in all_ids))
        for command in ("approve", "deny"):
            refused(shell("ca", command, wrong), f"0 requests begin with {wrong!r}")
    for longer in (f"{request_id}0", f"{request_id}00", f" {request_id}"):
        assert shell("ca", "deny", longer).code == 1
    assert [each.state for each in store.requests.open()] == ["pending"]
    assert shell.unlocked("ca", "approve", request_id[:11].upper()).code == 0
