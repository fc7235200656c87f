"""`rossec ca thing | things`, and `rossec ca revoke --thing`."""

import json
from pathlib import Path

import pytest

from ca.enrollment import qr
from ca.things import ThingKey, peek_statement
from tests.rossec.cli.ca.record import key_of, listed
from tests.support.commands import Shell, refused
from tests.support.pki import new_signer

LAMP, FAR = "/things/lamp", ("--master", "http://127.0.0.1:1")


class Bench:
    """A border router, and credentials of things in files."""

    def __init__(self, shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
        self.shell = shell
        monkeypatch.chdir(shell.root)
        shell.enroll("/border")
        self.lamp = self.credential("lamp", b"\x2b")

    def credential(self, name: str, kid: bytes) -> Path:
        path = self.shell.root / f"{name}.ccs"
        path.write_bytes(ThingKey.of(new_signer().public_key, kid, name).ccs)
        return path

    def thing(self, name: str = LAMP, *more: str) -> object:
        return self.shell.unlocked("ca", "thing", name, "--yes", *FAR, *more)

    def state(self) -> list[dict[str, object]]:
        found = json.loads(self.shell("ca", "things", "--all", "--json").out)
        assert isinstance(found, list)
        return found


@pytest.fixture
def bench(shell: Shell, monkeypatch: pytest.MonkeyPatch) -> Bench:
    return Bench(shell, monkeypatch)


def test_a_thing_is_stated_and_installed_at_its_router(bench: Bench) -> None:
    shell = bench.shell
    assert shell("ca", "things").out == "no things\n"
    code = qr.label_code(bench.lamp.read_bytes())
    said = bench.shell.unlocked(
        "ca", "thing", LAMP, "--border", "/border", "--key", str(bench.lamp), "--code", code, "--yes", *FAR
    )
    assert said.code == 0, said
    assert "/things/lamp at the border router /border" in said.out
    assert "kid 2b" in said.out
    assert "the code of its label fits" in said.out
    assert f"given to its border router in {shell.node('/border') / 'things'}" in said.out
    found = peek_statement((shell.root / "things.lamp.thing").read_bytes())
    assert found.name == LAMP
    line = shell("ca", "things").out
    assert line.startswith("/things/lamp  at /border  until ")
    shell.enroll(LAMP)
    for name in (LAMP, "/border"):
        last = shell("ca", "show", name).out.splitlines()[-1]
        assert last.startswith("thing /things/lamp at /border, until ")
    (state,) = bench.state()
    assert (state["state"], state["class"], state["kid"]) == ("in force", "edhoc", "2b")
    assert state["border_key"] == key_of(shell, "/border").hex()
    assert shell("ca", "log", "verify").code == 0


def test_the_identity_is_signed_in_the_same_step(bench: Bench) -> None:
    shell = bench.shell
    shell("border", "add", LAMP, "--key", str(bench.lamp))
    request = shell.node(LAMP) / "node.csr"
    said = shell.unlocked(
        "ca",
        "thing",
        LAMP,
        "--border",
        "/border",
        "--key",
        str(bench.lamp),
        "--yes",
        "--request",
        str(request),
        "--out",
        "lamp.thing",
        *FAR,
    )
    assert "and an identity for its node" in said.out
    assert shell("node", "show", LAMP).code == 0
    assert (shell.root / "lamp.thing").exists()


def test_elsewhere_it_is_written_to_files(bench: Bench) -> None:
    shell = bench.shell
    shell("node", "request", LAMP)
    request = shell.root / "lamp.csr"
    (shell.node(LAMP) / "node.csr").rename(request)
    for name in (LAMP, "/border"):
        shell.node(name).rename(shell.root / name.replace("/", "_"))
    said = shell.unlocked(
        "ca",
        "thing",
        LAMP,
        "--border",
        "/border",
        "--key",
        str(bench.lamp),
        "--yes",
        "--request",
        str(request),
        *FAR,
    )
    bundle = request.with_name("lamp.pem")
    assert f"rossec border install things.lamp.thing {bundle}\n" in said.out
    assert bundle.exists()


def test_the_label_must_be_that_of_the_thing(bench: Bench) -> None:
    other = qr.label_code(bench.credential("fan", b"\x01").read_bytes())
    said = bench.shell.unlocked(
        "ca", "thing", LAMP, "--border", "/border", "--key", str(bench.lamp), "--code", other
    )
    refused(said, "the code on the label is not that of this credential", "scan the label")
    assert bench.state() == []


def test_a_renamed_thing_and_its_former_name(bench: Bench) -> None:
    shell = bench.shell
    order = ("--border", "/border", "--key", str(bench.lamp), "--yes", *FAR)
    shell.unlocked("ca", "thing", LAMP, *order)
    refused(
        shell.unlocked("ca", "thing", "/things/light", *order),
        "this key is that of /things/lamp",
        "--replace /things/lamp",
    )
    said = shell.unlocked("ca", "thing", "/things/light", *order, "--replace", LAMP)
    assert "what it replaces is revoked (1 entry)" in said.out
    assert said.code == 3  # no master took the list
    former, now = bench.state()
    assert (former["state"], now["state"]) == ("revoked", "in force")
    assert former["id"] in {entry.hex() for entry in listed(shell)}
    assert "/things/light" in shell("ca", "things").out
    assert LAMP not in shell("ca", "things").out


def test_a_thing_is_revoked(bench: Bench) -> None:
    shell = bench.shell
    shell.unlocked("ca", "thing", LAMP, "--border", "/border", "--key", str(bench.lamp), "--yes", *FAR)
    said = shell.unlocked("ca", "revoke", "--thing", LAMP, *FAR)
    assert said.out == "revoked the thing /things/lamp, 1 statement (list 2)\n"
    refused(said, "did not take the list", "rossec ca publish", code=3)
    refused(shell.unlocked("ca", "revoke", "--thing", LAMP), "no statement about a thing", "ca things")
    assert [each["state"] for each in bench.state()] == ["revoked"]


def test_a_renewal(bench: Bench) -> None:
    shell = bench.shell
    shell.unlocked(
        "ca", "thing", LAMP, "--border", "/border", "--key", str(bench.lamp), "--for", "1d", "--yes", *FAR
    )
    said = shell.unlocked("ca", "thing", LAMP, "--renew", "--for", "90d")
    assert said.code == 0, said
    assert [each["state"] for each in bench.state()] == ["renewed", "in force"]
    refused(shell.unlocked("ca", "thing", LAMP, "--renew", "--border", "/border"), "takes nothing new")
    refused(shell.unlocked("ca", "thing", "/things/fan", "--renew"), "there is no thing")


def test_what_is_missing_is_said(bench: Bench) -> None:
    shell = bench.shell
    refused(shell.unlocked("ca", "thing", LAMP), "which border router", "--border NAME")
    refused(
        shell.unlocked("ca", "thing", LAMP, "--border", "/border"),
        "a key or a secret",
        "--key FILE, --psk FILE or --renew",
    )
    secret = shell.root / "secret"
    secret.write_bytes(bytes(16))
    refused(
        shell.unlocked("ca", "thing", LAMP, "--border", "/border", "--psk", str(secret)),
        "not a description of a secret",
        "not the secret",
    )
    refused(
        shell.unlocked("ca", "thing", LAMP, "--border", "/border", "--key", str(secret)),
        "not a credential of a thing",
    )
    refused(
        shell.unlocked("ca", "thing", LAMP, "--border", "/attic", "--key", str(bench.lamp), "--yes"),
        "/attic has no valid identity",
        "rossec node request /attic",
    )
    assert bench.state() == []
