"""Transcripts of `--json`: stdout is one document, whose keys are those of the specification."""

import json
import re
from pathlib import Path
from typing import Any, Final

import pytest

from ca.names import MASTER
from tests.rossec.cli.grant.test_request import POLICY
from tests.support.commands import Said, Shell

ROOT: Final = Path(__file__).parents[3]
SPEC: Final = (ROOT / "docs/spec/results.md").read_text()
NOBODY: Final = ("--master", "http://127.0.0.1:1")
DELIVERED: Final = {"given", "deposited", "refused", "undelivered"}
ENTRY: Final = {"name", "file", "id", "ok"}
REFUSED: Final = {"error", "hint"}


def keys_of(words: tuple[str, ...]) -> set[str]:
    """The keys that the specification has for the command these words begin with."""
    for length in (3, 2):
        name = " ".join(words[:length])
        for row in SPEC.splitlines():
            if re.match(rf"\| .*`{re.escape(name)}`.* \|", row):
                return set(re.findall(r"`([a-z_]+)`", row.split("|")[2]))
    raise AssertionError(f"{words} is not specified")


def document(shell: Shell, *words: str, unlocked: bool = False, code: int = 0) -> dict[str, Any]:
    said: Said = (shell.unlocked if unlocked else shell)(*words, "--json")
    assert said.code == code, said
    (line,) = said.out.splitlines()
    found: dict[str, Any] = json.loads(line)
    allowed = keys_of(words) | DELIVERED | (REFUSED if code else set())
    assert set(found) <= allowed | {"results"}, words
    for entry in found.get("results", ()):
        assert set(entry) <= allowed | ENTRY | REFUSED, words
    return found


@pytest.fixture
def site(shell: Shell, monkeypatch: pytest.MonkeyPatch) -> Shell:
    monkeypatch.chdir(shell.root)
    shell.enroll("/heating")
    (shell.root / "ca" / "policy.yaml").write_text(POLICY)
    return shell


def test_documents_of_a_nodes_host(site: Shell) -> None:
    made = document(site, "node", "request", "/robot")
    (entry,) = made["results"]
    assert entry["name"] == "/robot"
    (signed,) = document(site, "ca", "sign", entry["file"], "--yes", unlocked=True)["results"]
    assert signed["name"] == "/robot"
    (installed,) = document(site, "node", "install", signed["identity"], "--yes")["results"]
    assert installed == {"file": signed["identity"], "name": "/robot", "domain": "home", "ok": True}
    assert document(site, "node", "code", "/robot")["code"].startswith("ROSSEC:")
    assert document(site, "node", "labels", "/l", "/m", "--out", "l.html")["names"] == ["/l", "/m"]
    granted = document(site, "grant", "sign", "/robot", "--publish", "/x", "--out", "x.grant", unlocked=True)
    assert granted["file"] == "x.grant"
    shown = document(site, "grant", "show", "x.grant")
    assert shown["id"] == granted["id"]
    assert [link["permissions"][0]["pattern"] for link in shown["links"]] == ["/x"]
    (held,) = document(site, "grant", "install", "x.grant")["results"]
    assert (held["grant"], held["node"]) == (granted["id"], "/robot")
    presets = document(site, "grant", "presets")["presets"]
    assert presets
    assert all(set(each) == {"name", "hides", "discloses"} for each in presets)
    assert document(site, "privacy", "opt-out", "/x", *NOBODY, unlocked=True)["rule"]


def test_documents_of_requests_for_grants(site: Shell) -> None:
    def ask(*rights: str) -> str:
        asked = document(site, "grant", "request", "/heating", *rights, "--why", "to heat")
        assert asked["inbox"] is True
        return str(asked["request"])

    ask("--publish", "/heat")
    decided = document(site, "grant", "decide", unlocked=True)
    assert (decided["allowed"], decided["waiting"]) == (1, 0)
    assert [each["node"] for each in decided["grants"]] == ["/heating"]
    lift = ask("--call", "/lift")
    approved = document(site, "grant", "approve", lift[:8], unlocked=True)
    assert [each["ok"] for each in approved["results"]] == [True]
    assert len(approved["grants"]) == 1
    lift, other = ask("--call", "/lift"), "ffffffff"
    denied = document(site, "grant", "deny", lift[:8], other, code=1)
    assert [each["ok"] for each in denied["results"]] == [True, False]
    assert denied["results"][0]["requests"] == [{"node": "/heating", "right": "call", "name": "/lift"}]


def test_documents_of_the_authority(site: Shell, tmp_path: Path) -> None:
    assert document(site, "ca", "publish", *NOBODY, code=3)["published"] is False
    refreshed = document(site, "ca", "refresh", *NOBODY, unlocked=True, code=3)
    assert refreshed["expires"] > 0
    assert document(site, "ca", "log", "head", unlocked=True)["entries"] > 0
    invited = document(site, "ca", "invite", "/guest/*", "--address", "127.0.0.1:11318")
    assert invited["pattern"] == "/guest/*"
    (ended,) = document(site, "ca", "invitations", "revoke", invited["id"][:8])["results"]
    assert ended["invitation"] == invited["id"]
    written = document(site, "ca", "backup", str(tmp_path / "b"), unlocked=True)
    assert written["domain"] == "home"
    site.enroll(MASTER)
    delegated = document(site, "master", "delegate", *NOBODY, unlocked=True, code=3)
    assert (delegated["master"], delegated["published"]) == (MASTER, False)
    bundle = document(site, "domain", "bundle", "--out", "home.bundle", unlocked=True)
    assert bundle["fingerprint"]


def test_documents_of_other_tools(site: Shell) -> None:
    site.enroll(MASTER)
    assert (
        document(
            site, "federation", "add", "http://10.0.0.2:11311", "--as", "attic", "--name", "/master/attic"
        )["label"]
        == "attic"
    )
    assert document(site, "federation", "param", "attic", "/robot/**")["mirrored"] is True
    gone = document(site, "federation", "remove", "attic", "cellar", code=1)
    assert [each["ok"] for each in gone["results"]] == [True, False]
    site("router", "accounts", "add", "home", "--host", "10.0.0.1")
    (account,) = document(site, "router", "accounts", "remove", "home")["results"]
    assert account == {"name": "home", "ok": True}
    assert Path(document(site, "namespace", "messages", str(site.root))["path"]).exists()


def test_a_secret_of_a_thing_is_only_in_the_document(site: Shell) -> None:
    site.enroll("/border")
    said = site("border", "add", "/things/lamp", "--psk", "--json")
    found = json.loads(said.out)
    assert found["secret"]
    assert found["secret"] not in said.err
    assert set(found) <= keys_of(("border", "add"))
    (gone, unknown) = document(site, "border", "forget", "/things/lamp", "/x", code=1)["results"]
    assert (gone["ok"], unknown["ok"]) == (True, False)
