"""The console as a command: it serves until a signal, and leaves nothing behind."""

import asyncio
import os
import pwd
import signal
from pathlib import Path

import pytest

from rossec.console.options import ConsoleEndpoint, ConsoleOptions, read_options
from rossec.console.server.supervisor import WebOptions, settings_for, supervise
from rossec.errors import ConfigurationError
from tests.support.consoleprocess import UNMEASURED, listening
from tests.support.ports import free_port
from tests.support.serviceprocess import children_of


def test_on_localhost_only_this_user_may_connect() -> None:
    local = settings_for(read_options(ConsoleOptions(), "host"), "home")
    assert local.users == frozenset({os.geteuid()})
    assert local.origins == ("http://localhost:7411",)
    lan = settings_for(read_options(ConsoleOptions(lan=True, name="a.local", read_only=True), "h"), "home")
    assert (lan.users, lan.hsts, lan.read_only) == (None, False, True)


def test_a_proxy_is_of_this_user_or_of_the_one_named() -> None:
    own, origin = os.geteuid(), "https://a.example"
    path = Path("/run/c.sock")
    alone = settings_for(read_options(ConsoleOptions(unix_path=path, origin=origin), "h"), "home")
    assert (alone.users, alone.proxy_users) == (None, frozenset({own}))
    named = ConsoleOptions(unix_path=path, origin=origin, proxy_user="nobody")
    nobody = pwd.getpwnam("nobody").pw_uid
    assert settings_for(read_options(named, "h"), "home").proxy_users == {own, nobody}
    missing = ConsoleOptions(unix_path=path, origin=origin, proxy_user="no-such-user")
    with pytest.raises(ConfigurationError, match="there is no user 'no-such-user'"):
        settings_for(read_options(missing, "h"), "home")


async def run(endpoint: ConsoleEndpoint, directory: Path) -> list[str]:
    """Run it until it serves, then end it with SIGTERM."""
    done: list[str] = []

    def ready() -> None:
        done.append("ready")
        os.kill(os.getpid(), signal.SIGTERM)

    options = WebOptions(settings_for(endpoint, "home"), directory / "console.sock")
    await supervise(endpoint, options, UNMEASURED, ready)
    return done


async def test_it_serves_until_a_signal(tmp_path: Path) -> None:
    endpoint = read_options(ConsoleOptions(port=free_port()), "host")
    before = children_of(os.getpid())
    assert await run(endpoint, tmp_path) == ["ready"]
    assert children_of(os.getpid()) == before


async def test_a_proxys_socket_is_gone_afterwards(tmp_path: Path) -> None:
    options = ConsoleOptions(unix_path=tmp_path / "proxy.sock", origin="https://ca.example.org")
    assert await run(read_options(options, "host"), tmp_path) == ["ready"]
    assert not (tmp_path / "proxy.sock").exists()


async def test_a_port_that_is_taken_is_told(tmp_path: Path) -> None:
    with listening() as sock:
        endpoint = read_options(ConsoleOptions(port=sock.getsockname()[1]), "host")
        with pytest.raises(ConfigurationError, match="cannot listen"):
            await asyncio.wait_for(run(endpoint, tmp_path), 10)
