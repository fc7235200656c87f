import io
import json
from pathlib import Path

import pytest

from tests.rossec.cli.ca.record import key_of, listed
from tests.support.commands import Shell, refused


def test_signing_shows_the_request(shell: Shell) -> None:
    shell("node", "request", "/robot")
    request = shell.node("/robot") / "node.csr"
    said = shell.unlocked("ca", "sign", str(request), "--yes")
    assert "spiffe://home/robot asks for an identity" in said.out
    assert "no code was checked" in said.out
    assert said.out.endswith(f"signed /robot: {request.with_name('node.pem')}\n")


def test_a_code_is_checked_against_its_request(shell: Shell) -> None:
    for name in ("/robot", "/other"):
        shell("node", "request", name)
    code = shell("node", "code", "/robot", "--text").out.strip()
    right, wrong = (str(shell.node(name) / "node.csr") for name in ("/robot", "/other"))
    sign = ("ca", "sign", "--yes", "--code", code)
    refused(shell.unlocked(*sign, wrong), "does not fit the codes", "scan the code again")
    refused(shell.unlocked(*sign, right, wrong), "does not fit the codes")
    refused(shell.unlocked(*sign, right, "--code", code), "does not fit the codes")
    assert "its code fits" in shell.unlocked(*sign, right).out
    refused(shell.unlocked("ca", "sign", right, "--yes", "--code", "x"), "not the text of a rossec")


def test_another_key_for_a_known_name_needs_replace_key(shell: Shell) -> None:
    shell.enroll("/robot")
    shell.node("/robot").rename(shell.root / "lost")
    shell("node", "request", "/robot")
    request = str(shell.node("/robot") / "node.csr")
    refused(shell.unlocked("ca", "sign", request, "--yes"), "another key", "--replace-key /robot")
    old = key_of(shell, "/robot")
    sign = ("ca", "sign", request, "--yes", "--replace-key", "/robot", "--master", "http://127.0.0.1:1")
    said = shell.unlocked(*sign)
    assert said.out.endswith("node.pem\nthe replaced key is revoked\n")
    refused(said, "did not take the list", "rossec ca publish", code=3)
    assert listed(shell) == {old}
    assert shell.unlocked("ca", "sign", request, "--yes").code == 0  # the same key again


def test_an_invalid_request_is_refused(shell: Shell, tmp_path: Path) -> None:
    (tmp_path / "x.csr").write_bytes(b"nothing of the kind")
    said = shell.unlocked("ca", "sign", str(tmp_path / "x.csr"), "--yes")
    assert said.code == 1
    (tmp_path / "big.csr").write_bytes(bytes(100_000))
    assert shell.unlocked("ca", "sign", str(tmp_path / "big.csr"), "--yes").code == 1
    refused(shell("ca", "sign", str(tmp_path / "none.csr")), "does not exist", code=2)


def test_a_request_with_another_name_gets_another_file(shell: Shell, tmp_path: Path) -> None:
    shell("node", "request", "/robot")
    copy = tmp_path / "robot.csr"
    copy.write_bytes((shell.node("/robot") / "node.csr").read_bytes())
    shell.unlocked("ca", "sign", str(copy), "--yes")
    assert (tmp_path / "robot.pem").exists()


def test_a_wrong_passphrase_file_is_refused(shell: Shell, tmp_path: Path) -> None:
    shell("node", "request", "/robot")
    request = str(shell.node("/robot") / "node.csr")
    wrong = tmp_path / "wrong"
    wrong.write_text("not the passphrase\n")
    wrong.chmod(0o600)
    sign = ("ca", "sign", request, "--yes", "--passphrase-file")
    refused(shell(*sign, str(wrong)), "passphrase")
    wrong.chmod(0o644)
    refused(shell(*sign, str(wrong)), "can be read by others", "chmod 600")
    empty = tmp_path / "empty"
    empty.touch(0o600)
    refused(shell(*sign, str(empty)), "is empty", "first line")


def test_without_an_answer_nothing_is_signed(shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO(""))
    shell("node", "request", "/robot")
    said = shell.unlocked("ca", "sign", str(shell.node("/robot") / "node.csr"))
    assert "there was no answer, nothing was done" in said.err
    assert "--yes" in said.err
    assert not (shell.node("/robot") / "node.pem").exists()


@pytest.mark.parametrize(("typed", "code"), [("y\n", 0), ("n\n", 1)])
def test_the_typed_answer_decides(
    shell: Shell, monkeypatch: pytest.MonkeyPatch, typed: str, code: int
) -> None:
    shell("node", "request", "/robot")
    monkeypatch.setattr("sys.stdin", io.StringIO(typed))
    assert shell.unlocked("ca", "sign", str(shell.node("/robot") / "node.csr")).code == code
    assert (shell.node("/robot") / "node.pem").exists() == (code == 0)


def test_both_sides_show_the_same_fingerprint(shell: Shell) -> None:
    requested = shell("node", "request", "/robot").out.splitlines()[1]
    assert len(requested.split()) == 9
    request = str(shell.node("/robot") / "node.csr")
    assert f"  {requested}\n" in shell.unlocked("ca", "sign", request, "--yes").out
    shell("node", "install", str(shell.node("/robot") / "node.pem"), "--yes")
    assert requested in shell("node", "show", "/robot").out.splitlines()
    assert requested in shell("ca", "show").out.splitlines()[-1]


def test_an_identity_lasts_a_year_at_most(shell: Shell) -> None:
    shell("node", "request", "/robot")
    request = str(shell.node("/robot") / "node.csr")
    said = shell.unlocked("ca", "sign", request, "--yes", "--for", "367d")
    refused(said, "367d is too long; at most 366d are allowed", "ca sign --help", code=2)
    assert shell.unlocked("ca", "sign", request, "--yes", "--for", "366d").code == 0


def test_a_wildcard_request_needs_the_anonymous_option(shell: Shell) -> None:
    said = shell("node", "request", "/rviz", "--anonymous")
    request = str(shell.node("/rviz") / "node.csr")
    assert said.out.endswith(f"rossec ca sign {request} --anonymous\n")
    sign = ("ca", "sign", request, "--yes")
    refused(shell.unlocked(*sign), "asks for all names that begin with /rviz_", "--anonymous")
    signed = shell.unlocked(*sign, "--anonymous")
    assert "it may run as any number of nodes, under every name that begins with /rviz_" in signed.out
    assert "one key and the same grants, and are revoked together" in signed.out
    assert shell("node", "install", str(shell.node("/rviz") / "node.pem"), "--yes").code == 0
    assert "also for anonymous nodes, /rviz_*" in shell("node", "show", "/rviz").out
    assert "/rviz and /rviz_*  until" in shell("ca", "show").out
    listed = json.loads(shell("ca", "show", "--json").out)["identities"]
    assert {node["name"]: node["anonymous"] for node in listed} == {"/ca": False, "/rviz": True}


def test_the_authority_decides_on_the_wildcard_not_the_request(shell: Shell) -> None:
    shell("node", "request", "/rviz")
    request = str(shell.node("/rviz") / "node.csr")
    assert shell.unlocked("ca", "sign", request, "--yes", "--anonymous").code == 0
    assert "/rviz and /rviz_*" in shell("ca", "show").out
    shell("node", "request", "/rviz_9")
    other = str(shell.node("/rviz_9") / "node.csr")
    refused(shell.unlocked("ca", "sign", other, "--yes"), "/rviz_9 and /rviz", "revoke /rviz first")


@pytest.mark.parametrize("name", ["/master", "/ca"])
def test_the_master_and_the_authority_get_no_wildcard(shell: Shell, name: str) -> None:
    refused(shell("node", "request", name, "--anonymous"), f"{name} is a single node")
    shell.node(name).rename(shell.root / "aside")
    shell("node", "request", name)
    request = str(shell.node(name) / "node.csr")
    said = shell.unlocked("ca", "sign", request, "--yes", "--anonymous")
    refused(said, f"{name} is a single node", "a name of their own")


def test_a_link_beside_a_request_is_not_followed(shell: Shell, tmp_path: Path) -> None:
    shell("node", "request", "/robot")
    request, target = tmp_path / "node.csr", tmp_path / "target"
    request.write_bytes((shell.node("/robot") / "node.csr").read_bytes())
    target.write_bytes(b"precious")
    (tmp_path / "node.pem").symlink_to(target)
    said = shell.unlocked("ca", "sign", str(request), "--yes")
    assert (said.code, "is not a plain file" in said.err) == (1, True)
    assert target.read_bytes() == b"precious"
    (tmp_path / "node.pem").unlink()
    assert shell.unlocked("ca", "sign", str(request), "--yes").code == 0, "signed once"
    assert (tmp_path / "node.pem").read_bytes().startswith(b"-----BEGIN")


def test_one_refused_request_does_not_fail_the_rest(shell: Shell, tmp_path: Path) -> None:
    """One that is no request, one whose name has another key, and between them two good ones."""
    files = []
    for name in ("/one", "/held", "/two"):
        shell("node", "request", name)
        files.append(str(shell.node(name) / "node.csr"))
    assert shell.unlocked("ca", "sign", files[1], "--yes").code == 0
    (shell.node("/held") / "node.key").unlink()
    shell("node", "request", "/held")  # a new key
    bad = tmp_path / "bad.csr"
    bad.write_bytes(b"not a request")
    said = shell.unlocked("ca", "sign", str(bad), *files, "--yes")
    assert said.code == 1
    assert [line for line in said.out.splitlines() if line.startswith("signed")] == [
        f"signed /one: {shell.node('/one') / 'node.pem'}",
        f"signed /two: {shell.node('/two') / 'node.pem'}",
    ]
    errors = said.err.splitlines()
    assert errors[0].startswith(f"rossec: error: {bad}: ")
    assert errors[1].startswith("rossec: hint: ")
    assert errors[2].startswith(f"rossec: error: {files[1]}: /held has an identity with another")
    assert "--replace-key /held" in errors[3]
    assert errors[4:] == ["rossec: error: 2 of 4 were refused", "rossec: hint: see above"]


def test_if_all_requests_are_refused_no_question_is_asked(shell: Shell, tmp_path: Path) -> None:
    bad = [tmp_path / "a.csr", tmp_path / "b.csr"]
    for path in bad:
        path.write_bytes(b"not a request")
    said = shell("ca", "sign", *map(str, bad))
    assert said.code == 1
    assert said.out == ""
    assert said.err.splitlines()[-2] == "rossec: error: 2 of 2 were refused"
