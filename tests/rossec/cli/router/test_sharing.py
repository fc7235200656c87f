import io
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.commands import Shell, refused

HOST = ("--host", "a.example.org")


@pytest.fixture
def shared(empty: Shell) -> Path:
    """What a router with one account shares."""
    assert empty("router", "accounts", "add", "home", *HOST).code == 0
    said = empty("router", "share")
    assert "keep it to yourself" in said.err
    path = empty.root / "share.json"
    path.touch(mode=0o600)
    path.write_text(said.out)
    return path


def test_a_second_router_takes_over_what_the_first_shares(empty: Shell, shared: Path) -> None:
    second = ("router", "--home", str(empty.root / "second"))
    said = empty(*second, "take", str(shared), "--host", "b.example.org")
    assert said.out == "accounts: home; joins tls/a.example.org:7447\n"
    assert empty(*second, "accounts", "list").out == "home\n"
    account = empty(*second, "accounts", "show", "home").out
    assert "tls/b.example.org:7447" in account
    assert "tls/a.example.org:7447" in account


def test_it_comes_by_standard_input(empty: Shell, shared: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(shared.read_bytes())))
    said = empty("router", "--home", str(empty.root / "second"), "take", "-")
    assert said.out.startswith("accounts: home; joins")


def test_what_cannot_be_taken(empty: Shell, shared: Path) -> None:
    refused(empty("router", "take", "nothing.json"), "there is no nothing.json", "router share")
    other = ("router", "--home", str(empty.root / "other"))
    assert empty(*other, "accounts", "add", "clinic", *HOST).code == 0
    refused(empty(*other, "take", str(shared)), "routers of another authority", "--home")
    shared.write_text("{}")
    refused(empty("router", "take", str(shared)), "this is no rossec-routers file", "router share")


def test_a_router_that_was_never_told_its_name_shares_nothing(empty: Shell) -> None:
    refused(empty("router", "share"), "there is no")


@pytest.mark.parametrize("words", [("share",), ("accounts", "show", "home")], ids=" ".join)
def test_what_a_shell_writes_of_it_is_read_by_this_user_alone(empty: Shell, words: tuple[str, ...]) -> None:
    assert empty("router", "accounts", "add", "home", *HOST).code == 0
    path = empty.root / "written"
    path.touch(mode=0o644)
    with path.open("w") as file:
        command = [sys.executable, "-I", "-m", "rossec", "router", *words]
        subprocess.run(command, stdout=file, env=empty.environ, check=True, timeout=60)
    assert path.stat().st_mode & 0o777 == 0o600
    assert "password" in path.read_text() or "authority_key" in path.read_text()
