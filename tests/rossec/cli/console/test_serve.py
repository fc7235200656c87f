"""`rossec console` in this process, until a signal ends it."""

import json
import os
import signal
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator

import pytest

from rossec.authority.home import AuthorityHome
from rossec.cli import console as module
from rossec.console.listening import NAME
from tests.support.commands import Said, Shell, refused
from tests.support.keyservice import running_service
from tests.support.ports import free_port


@pytest.fixture
def service(shell: Shell) -> Iterator[None]:
    """The authority's service, whose codes are all the same."""
    with running_service(AuthorityHome.at(shell.root), phone_code=lambda _: "CODE"):
        yield


def console(shell: Shell, *options: str, meanwhile: Callable[[], None] = lambda: None) -> Said:
    """Run the console, `meanwhile` in a thread once it serves, and end it with SIGTERM."""
    address = shell.root / "ca" / NAME
    ended = threading.Event()

    def end() -> None:
        deadline = time.monotonic() + 30
        while time.monotonic() < deadline and not ended.is_set() and not address.exists():
            time.sleep(0.02)
        try:
            meanwhile()
        finally:
            if not ended.is_set():
                time.sleep(0.2)  # it says that it is ready
                os.kill(os.getpid(), signal.SIGTERM)

    thread = threading.Thread(target=end)
    thread.start()
    try:
        return shell("console", *options)
    finally:
        ended.set()
        thread.join()


def test_it_serves_and_shows_a_code(shell: Shell, service: None) -> None:
    port = free_port()
    pages: list[bytes] = []

    def look() -> None:
        with urllib.request.urlopen(f"http://localhost:{port}/login") as answer:
            pages.append(answer.read())

    said = console(shell, "--port", str(port), meanwhile=look)
    assert said.code == 0, said.err
    assert f"http://localhost:{port}/login#CODE" in said.out
    assert "\u2580" in said.out  # the same as a QR code
    assert "Ctrl-C ends it" in said.out
    assert b"Who is there?" in pages[0]
    assert not (shell.root / "ca" / NAME).exists()


def test_it_says_that_it_is_ready_as_json(shell: Shell, service: None) -> None:
    port = free_port()
    said = console(shell, "--port", str(port), "--json")
    origin = f"http://localhost:{port}"
    expected = {"ready": origin, "login": f"{origin}/login#CODE", "process": os.getpid()}
    assert json.loads(said.out) == expected


def test_without_the_service_it_says_how_to_start_it(shell: Shell) -> None:
    refused(shell("console"), "the authority's service does not run", "rossec ca serve")


def test_without_an_authority_there_is_nothing_to_show(empty: Shell) -> None:
    refused(empty("console"), "there is no authority", "rossec ca init")


def test_without_its_libraries_it_says_how_to_get_them(shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "find_spec", lambda _: None)
    refused(shell("console"), "libraries that are not installed", "pip install 'rossec[console]'")


def test_for_phones_on_the_network_it_shows_its_authority(shell: Shell, service: None) -> None:
    port = free_port()
    said = console(shell, "--lan", "--name", "robot.local", "--port", str(port))
    assert said.code == 0, said.err
    assert f"https://robot.local:{port}/login#CODE" in said.out
    assert "start with --hand-out" in said.out
