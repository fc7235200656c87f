import io
import json
from pathlib import Path

import pytest

from ca.enrollment import qr
from rossec.enrollment.enroll import code_in
from tests.rossec.naming.stylesheets import gives
from tests.support.commands import Shell, refused


def test_a_request_names_the_next_command(shell: Shell) -> None:
    said = shell("node", "request", "/robot")
    assert said.out.splitlines()[-1] == (
        f"next, at the authority: rossec ca sign {shell.node('/robot')}/node.csr"
    )
    refused(shell("node", "request", "/robot"), "has a key already", "node.csr")
    refused(shell("node", "request", "robot"), "not an absolute ROS name", "for example /robot:")


def test_a_request_for_the_name_that_rules_give(shell: Shell, tmp_path: Path) -> None:
    meta, sheet = tmp_path / "lamp.xml", tmp_path / "rules.xsl"
    meta.write_bytes(b"<node><group>lamps</group><name>desk</name></node>")
    said = shell("node", "request", "--meta", str(meta))
    assert said.out.startswith("request of /lamps/desk: "), said.err
    assert (shell.node("/lamps/desk") / "node.csr").exists()
    sheet.write_bytes(gives("concat('/own/', //name)"))
    said = shell("node", "request", "--meta", str(meta), "--rules", str(sheet))
    assert said.out.startswith("request of /own/desk: "), said.err
    meta.write_bytes(b"<node>")
    refused(shell("node", "request", "--meta", str(meta)), "metadata that are no XML")
    sheet.write_bytes(gives("'/master'"))
    meta.write_bytes(b"<node/>")
    said = shell("node", "request", "--meta", str(meta), "--rules", str(sheet))
    refused(said, "/master, which is reserved")


def test_a_name_or_metadata(shell: Shell, tmp_path: Path) -> None:
    meta = tmp_path / "lamp.xml"
    meta.write_bytes(b"<node/>")
    for words in ((), ("/a", "--meta", str(meta)), ("/a", "--rules", str(meta))):
        said = shell("node", "request", *words)
        assert said.code == 2
        assert "--meta FILE" in said.err


def test_the_code_is_shown_as_picture_and_text(shell: Shell, tmp_path: Path) -> None:
    shell("node", "request", "/robot")
    text = shell("node", "code", "/robot", "--text").out.strip()
    assert qr.parse(text).matches((shell.node("/robot") / "node.csr").read_bytes())
    shown = shell("node", "code", "/robot", "--svg", str(tmp_path / "code.svg")).out
    assert shown.splitlines()[-1] == text
    assert len(shown.splitlines()) > 15
    assert b"<svg" in (tmp_path / "code.svg").read_bytes()
    shell("node", "code", "/robot", "--png", str(tmp_path / "code.png"))
    assert code_in((tmp_path / "code.png").read_bytes()) == text
    refused(shell("node", "code", "/nobody"), "has no node.csr", "rossec node request /nobody")


def test_an_installed_node_shows_itself(shell: Shell) -> None:
    refused(shell("node", "show", "/robot"), "has no ca.pem", "rossec node request /robot")
    shell.enroll("/robot")
    assert shell("node", "show", "/robot").out.startswith("/robot of home until ")
    row = json.loads(shell("node", "show", "/robot", "--json").out)
    assert (row["name"], row["domain"], row["grants"]) == ("/robot", "home", 0)
    assert "\n0 grants in " in shell("node", "show", "/robot").out


def test_installing_shows_the_authority_and_asks(shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO(""))
    shell("node", "request", "/robot")
    shell.unlocked("ca", "sign", str(shell.node("/robot") / "node.csr"), "--yes")
    said = shell("node", "install", str(shell.node("/robot") / "node.pem"))
    assert "there was no answer, nothing was done" in said.err
    fingerprint = shell("ca", "show").out.splitlines()[1]
    assert fingerprint in said.out
    assert not (shell.node("/robot") / "ca.pem").exists()


def test_an_invalid_bundle_is_refused(shell: Shell, tmp_path: Path) -> None:
    (tmp_path / "x.pem").write_text("no certificate")
    refused(shell("node", "install", str(tmp_path / "x.pem"), "--yes"), "not a PEM certificate")
