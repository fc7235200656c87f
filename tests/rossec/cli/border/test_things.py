"""`rossec border add | install`."""

from pathlib import Path

import pytest

from ca.things import ThingKey, ThingSecret, parse_secret, read_description
from rossec.home import NodeHome
from rossec.saved_statements import ThingFiles
from tests.support.commands import Shell, refused
from tests.support.pki import new_signer

LAMP = "/things/lamp"


@pytest.fixture
def router(shell: Shell, monkeypatch: pytest.MonkeyPatch) -> Shell:
    monkeypatch.chdir(shell.root)
    shell.enroll("/border")
    (shell.root / "lamp.ccs").write_bytes(ThingKey.of(new_signer().public_key, b"\x2b").ccs)
    return shell


def files(shell: Shell) -> ThingFiles:
    return ThingFiles(NodeHome.of(shell.root, "/border"))


def command(said_out: str) -> list[str]:
    """The command that is to be typed at the authority."""
    (line,) = [line for line in said_out.splitlines() if line.startswith("next, at the authority")]
    return line.partition(": rossec ")[2].split()


def test_a_thing_with_a_key_needs_two_commands(router: Shell) -> None:
    said = router("border", "add", LAMP, "--key", "lamp.ccs")
    assert said.code == 0, said
    assert router("border", "add", LAMP, "--key", "lamp.ccs").out == said.out
    done = router.unlocked(*command(said.out), "--yes")
    assert done.code == 0, done
    assert files(router).load().statements.keys() == {LAMP}
    again = router("border", "install", "things.lamp.thing", str(router.node(LAMP) / "node.pem"))
    assert again.out.splitlines()[0] == "/things/lamp is enrolled in home"
    assert again.out.splitlines()[1].startswith("/things/lamp is served until ")


def test_a_thing_with_a_secret(router: Shell) -> None:
    said = router("border", "add", LAMP, "--psk", "--secret-out", "lamp.secret")
    assert said.code == 0, said
    out = router.root / "lamp.secret"
    assert out.stat().st_mode & 0o777 == 0o600
    kid, secret = parse_secret(out.read_text())
    assert files(router).secret(LAMP) == secret
    assert secret.hex() not in (said.out + said.err).lower()
    done = router.unlocked(*command(said.out), "--yes")
    assert done.code == 0, done
    statement = files(router).load().statements[LAMP]
    assert statement.credential == ThingSecret.of(secret, kid)
    for path in router.root.rglob("*"):  # the record and the log of the authority as well
        if path.is_file() and path not in (out, files(router).path / "things.lamp.key"):
            content = path.read_bytes()
            assert secret not in content
            assert secret.hex().encode() not in content.lower()


def test_a_secret_is_shown_once(router: Shell) -> None:
    said = router("border", "add", LAMP, "--psk")
    text = next(line for line in said.out.splitlines() if line.startswith("OSCORE:"))
    kid, secret = parse_secret(text)
    assert "it is not shown again" in said.err
    described = files(router).path / "things.lamp.psk"
    assert read_description(described.read_bytes()) == ThingSecret.of(secret, kid)
    refused(router("border", "add", LAMP, "--psk"), "exists and is not overwritten")


def test_what_does_not_fit_is_refused(router: Shell) -> None:
    refused(router("border", "add", LAMP), "a key or a secret", "--key FILE or --psk")
    refused(router("border", "add", LAMP, "--psk", "--key", "lamp.ccs"), "a key or a secret")
    refused(router("border", "add", LAMP, "--key", "lamp.ccs", "--secret-out", "x"), "has no secret")
    refused(router("border", "add", "/relay", "--key", "lamp.ccs"), "cannot be the name of a thing")
    refused(
        router("border", "add", LAMP, "--key", "lamp.ccs", "--as", "/attic"),
        "/attic has no ca.pem",
        "rossec node request /attic",
    )
    Path("there").write_text("")
    said = router("border", "add", LAMP, "--psk", "--secret-out", "there")
    refused(said, "there exists and is not overwritten")
    assert not files(router).path.exists()
    refused(router("border", "install", "lamp.ccs"), "not a statement of this authority")


def test_a_statement_before_its_identity(router: Shell) -> None:
    router.unlocked("ca", "thing", LAMP, "--border", "/border", "--key", "lamp.ccs", "--yes")
    said = router("border", "install", "things.lamp.thing")
    assert "the node /things/lamp has no identity here yet" in said.err


def test_the_identity_must_be_of_the_same_authority(router: Shell, tmp_path: Path) -> None:
    router.unlocked("ca", "thing", LAMP, "--border", "/border", "--key", "lamp.ccs", "--yes")
    there = Shell(tmp_path / "there", router._capsys)
    there("ca", "init", "home", "--passphrase-file", str(there.secret))
    there.enroll(LAMP)
    bundle = str(there.node(LAMP) / "node.pem")
    refused(router("border", "install", "things.lamp.thing", bundle), "another authority than that of")


def test_a_secret_that_nobody_got_is_made_anew(router: Shell) -> None:
    refused(router("border", "add", LAMP, "--psk", "--secret-out", "nowhere/lamp.secret"), "nowhere")
    assert not list(files(router).path.glob("things.lamp.*"))
    assert router("border", "add", LAMP, "--psk", "--secret-out", "lamp.secret").code == 0
