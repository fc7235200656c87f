"""`rossec ca serve` in this process, until a signal ends it."""

import asyncio
import json
import os
import signal
import socket
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from rossec.authority.console.client import ConsoleClient
from rossec.authority.home import AUDIT_FILE, AuthorityHome
from rossec.authority.keyservice.client import KeyServiceClient, service_lock
from rossec.cli.ca import serve as module
from rossec.host.audit import read_entries, verify
from tests.support.commands import Said, Shell, refused
from tests.support.ports import free_port


@pytest.fixture(autouse=True)
def _unprotected(monkeypatch: pytest.MonkeyPatch) -> None:
    """The process of the tests stays as it is (tests/integration runs the real one)."""
    monkeypatch.setattr(module, "protect_memory", lambda: None)


def serve(
    shell: Shell, *options: str, network: bool = False, meanwhile: Callable[[], None] = lambda: None
) -> Said:
    """Run the service, `meanwhile` in a thread, and end it with SIGTERM if it runs."""
    ended = threading.Event()

    def end() -> None:
        deadline = time.monotonic() + 20
        while time.monotonic() < deadline and not ended.is_set():
            client = KeyServiceClient.find(AuthorityHome.at(shell.root).path)
            if client is not None:
                client.close()
                break
            time.sleep(0.02)
        try:
            meanwhile()
        finally:
            if not ended.is_set():
                os.kill(os.getpid(), signal.SIGTERM)

    thread = threading.Thread(target=end)
    thread.start()
    try:
        return shell.unlocked("ca", "serve", *options, *([] if network else ["--no-network"]))
    finally:
        ended.set()
        thread.join()


def audit(shell: Shell) -> list[str]:
    text = (shell.root / "ca" / AUDIT_FILE).read_text()
    entries, damaged = read_entries(text.splitlines())
    assert damaged == []
    verify(entries)
    return [entry["text"] for entry in entries]


def test_it_holds_the_key_until_it_is_ended(shell: Shell) -> None:
    states = []

    def meanwhile() -> None:
        client = KeyServiceClient.find(shell.root / "ca")
        assert client is not None
        states.append(client.status()["remaining"])
        client.close()

    said = serve(shell, meanwhile=meanwhile)
    assert said.code == 0, said.err
    assert said.out == "authority of home: unlocked for 15m\n"
    assert states[0] in range(880, 901)
    assert audit(shell) == [
        "the audit begins",
        "unlocked for 900 s by the operator who started it",
        "the service began",
        "the service ended",
    ]
    assert not (shell.root / "ca" / "service.sock").exists()


def test_it_says_for_programs_that_it_is_ready(shell: Shell) -> None:
    said = serve(shell, "--json", "--unlock-for", "0")
    path, console = (str(shell.root / "ca" / f"{name}.sock") for name in ("service", "console"))
    assert json.loads(said.out) == {"ready": path, "console": console, "remaining": 0, "join_port": None}


def test_the_console_of_another_user_has_a_socket_elsewhere(shell: Shell) -> None:
    path = shell.root / "run" / "console.sock"
    path.parent.mkdir(mode=0o755)
    modes: list[int] = []
    names: list[str] = []

    def meanwhile() -> None:
        async def look() -> None:
            client = ConsoleClient(path)
            names.append((await client.status()).domain)
            await client.close()

        deadline = time.monotonic() + 10
        while not path.exists() and time.monotonic() < deadline:
            time.sleep(0.02)
        modes.append(path.stat().st_mode & 0o777)
        asyncio.run(look())

    options = ("--console-user", "nobody", "--console-socket", str(path))
    assert serve(shell, *options, meanwhile=meanwhile).code == 0
    assert (modes, names) == ([0o666], ["home"])
    assert not path.exists()


@pytest.mark.parametrize(
    ("options", "message", "hint"),
    [
        (("--console-user", "nobody"), "nobody cannot enter", "--console-socket"),
        (("--console-user", "no such"), "there is no user 'no such'", "--console-user"),
        (
            ("--console-user", "nobody", "--console-socket", "/no/such/x.sock"),
            "/no/such: No such file",
            "make it",
        ),
        (
            ("--console-user", "nobody", "--console-socket", "/tmp/x.sock"),
            "another user could replace the socket in /tmp",
            "a directory of your own",
        ),
    ],
)
def test_a_place_where_the_console_cannot_be_is_refused(
    shell: Shell, options: tuple[str, ...], message: str, hint: str
) -> None:
    refused(serve(shell, *options), message, hint)


def test_it_starts_locked_without_a_passphrase(shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    forms = list[str]()
    monkeypatch.setattr(module, "log_as_json", lambda: forms.append("json"))
    said = serve(shell, "--locked", "--log", "json")
    assert "locked; unlock it with: rossec ca unlock" in said.out
    assert "unlocked" not in " ".join(audit(shell))
    assert forms == ["json"]


def test_a_wrong_passphrase_ends_it(shell: Shell) -> None:
    shell.secret.write_text("something else\n")
    refused(shell.unlocked("ca", "serve"), "the passphrase does not open")
    assert audit(shell)[-1].startswith("failed to unlock for the operator who started it")


def test_two_services_are_one_too_many(shell: Shell) -> None:
    with service_lock(shell.root / "ca"):
        refused(shell.unlocked("ca", "serve"), "service runs from", "end it first")


def test_nodes_join_at_a_port_of_its_network_process(shell: Shell) -> None:
    port, found = free_port(), list[int]()

    def meanwhile() -> None:
        for _ in range(500):
            with socket.socket() as probe:
                if probe.connect_ex(("127.0.0.1", port)) == 0:
                    found.append(port)
                    return
            time.sleep(0.02)

    where = ("--join-address", f"127.0.0.1:{port}")
    said = serve(shell, *where, network=True, meanwhile=meanwhile)
    assert (said.code, found) == (0, [port]), said.err
    assert f"nodes join at port {port}" in said.out


def test_rules_are_tried_at_the_start(shell: Shell, tmp_path: Path) -> None:
    rules = tmp_path / "rules.xsl"
    rules.write_text("<nothing/>")
    where = ("--join-address", f"127.0.0.1:{free_port()}")
    said = serve(shell, *where, "--rules", str(rules), network=True)
    refused(said, "rules are an <xsl:stylesheet>")
    rules.write_text("<!DOCTYPE a><a/>")
    refused(shell.unlocked("ca", "serve", "--rules", str(rules)), "with a document type")
    said = shell.unlocked("ca", "serve", "--rules", str(rules), "--no-network")
    refused(said, "--rules are for nodes that join")


def test_a_port_that_is_taken_ends_it(shell: Shell) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        where = f"127.0.0.1:{taken.getsockname()[1]}"
        said = shell.unlocked("ca", "serve", "--join-address", where)
    refused(said, f"cannot listen on {where}", "--join-address")


def test_what_it_cannot_do_is_refused_before_it_starts(shell: Shell) -> None:
    refused(shell.unlocked("ca", "serve", "--apply", "--no-network"), "over the network")
    refused(shell.unlocked("ca", "serve", "--master", "nowhere"), "the master's URI")


def test_without_an_authority_there_is_nothing_to_serve(empty: Shell) -> None:
    refused(empty("ca", "serve"), "there is no authority", "rossec ca init")
