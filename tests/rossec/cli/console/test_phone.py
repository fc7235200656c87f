"""`rossec console phone`: a code, and what came of it."""

import json
import threading
import time
from collections.abc import Iterator

import pytest

from ca.approvals.passkeys import Passkey
from rossec.authority.home import AuthorityHome
from rossec.cli import phones as module
from rossec.console.listening import write_address
from tests.support.commands import Shell, refused
from tests.support.keyservice import running_service

ORIGIN = "http://localhost:7411"


@pytest.fixture
def home(shell: Shell) -> Iterator[AuthorityHome]:
    """An authority whose service and console run."""
    found = AuthorityHome.at(shell.root)
    write_address(found.path, ORIGIN)
    with running_service(found, phone_code=lambda _: "CODE"):
        yield found


def test_a_code_is_shown_as_an_address_and_a_picture(shell: Shell, home: AuthorityHome) -> None:
    said = shell("console", "phone", "--no-wait")
    assert said.code == 0
    assert f"\n{ORIGIN}/login#CODE\n" in said.out
    assert "\u2580" in said.out
    assert "within 2 minutes" in said.out


def test_a_name_goes_with_it(shell: Shell, home: AuthorityHome) -> None:
    said = shell("console", "phone", "--json", "--name", "Anna's phone")
    login = f"{ORIGIN}/login#CODE.Anna%27s%20phone"
    assert json.loads(said.out) == {"login": login, "seconds": 120}


@pytest.mark.parametrize("name", ["a" * 41, "a\nb"])
def test_a_name_is_one_short_line(shell: Shell, home: AuthorityHome, name: str) -> None:
    refused(shell("console", "phone", "--name", name), "a phone's name is one line")


def test_it_waits_until_a_phone_is_set_up(
    shell: Shell, home: AuthorityHome, monkeypatch: pytest.MonkeyPatch
) -> None:
    def add() -> None:
        time.sleep(0.3)
        store = home.store()
        store.passkeys.add(Passkey(b"id", "Anna's phone", b"key", bytes(16), "localhost", ORIGIN, b"", 1))
        store.close()

    monkeypatch.setattr(module, "CODE_LIFETIME", 20)
    thread = threading.Thread(target=add)
    thread.start()
    said = shell("console", "phone")
    thread.join()
    assert said.out.endswith("Anna's phone is set up\n")


def test_a_code_that_is_over_is_told(
    shell: Shell, home: AuthorityHome, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "CODE_LIFETIME", 0.1)
    assert shell("console", "phone").out.endswith("the code is over, and set up no phone\n")


def test_without_a_console_a_code_opens_nothing(shell: Shell) -> None:
    home = AuthorityHome.at(shell.root)
    with running_service(home, phone_code=lambda _: "CODE"):
        refused(shell("console", "phone"), "no console runs", "rossec console")


def test_without_the_service_there_is_no_code(shell: Shell) -> None:
    refused(shell("console", "phone"), "the authority's service does not run", "rossec ca serve")
