import asyncio
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import zenoh

from rossec.overlay.documents import Routers
from rossec.overlay.zenoh_carrier import Carrier
from tests.support.commands import Shell, refused
from tests.support.ports import free_port
from tests.support.routerprocess import RouterProcess, home_with


async def test_a_router_runs_until_it_is_told_to_end(short_path: Path) -> None:
    router = RouterProcess(home_with(short_path / "router", "home"))
    await router.start()
    carrier = await Carrier.open(router.routers("home"))
    assert carrier.router == router.locator
    await carrier.close()
    assert await router.stop() == 0
    assert router.log.read_text() == ""


def test_it_says_where_it_listens_and_who_has_an_account(empty: Shell) -> None:
    listen = f"tls/127.0.0.1:{free_port()}"
    assert empty("router", "accounts", "add", "home", "--host", "127.0.0.1").code == 0
    words = "router", "--listen", listen, "--join", f"tls/127.0.0.1:{free_port()}"
    command = [sys.executable, "-I", "-m", "rossec", *words]
    with subprocess.Popen(command, env=empty.environ, stdout=subprocess.PIPE, text=True) as router:
        assert router.stdout is not None
        lines = [router.stdout.readline().strip() for _ in range(3)]
        refused(empty("router"), "another router runs from", "--home")
        router.send_signal(signal.SIGTERM)
        assert router.wait(20) == 0
    assert lines == [f"router at {listen}", "accounts: home", f"joins {words[-1]}"]
    account = Routers.read(empty("router", "accounts", "show", "home").out.encode())
    assert account.locators == (listen, words[-1])


def test_an_open_router_says_what_that_means(empty: Shell) -> None:
    listen = f"tcp/127.0.0.1:{free_port()}"
    command = [sys.executable, "-I", "-m", "rossec", "router", "--open", "--listen", listen]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, env=empty.environ, stdout=pipe, stderr=pipe, text=True) as router:
        assert router.stdout is not None
        assert router.stdout.readline().strip() == f"router at {listen}"
        router.send_signal(signal.SIGINT)
        _, err = router.communicate(timeout=20)
    assert "whoever reaches it can use it" in err


def test_what_a_router_does_not_begin_with(empty: Shell) -> None:
    refused(empty("router"), "nobody has an account", "--open")
    refused(empty("router", "--listen", "7447"), "'7447' is not the address", "tls/")
    assert empty("router", "accounts", "add", "home", "--host", "127.0.0.1").code == 0
    refused(empty("router", "--open"), "the router has accounts (home)", "leave out --open")
    join = empty("router", "--join", "tcp/127.0.0.1:9", "--print-config")
    refused(join, "does not join tcp/127.0.0.1:9", "tls/")


def test_without_the_library(empty: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "zenoh", None)
    refused(empty("router", "--open"), "eclipse-zenoh is not installed", "rossec[overlay]")


def test_the_settings_of_a_stock_router(empty: Shell) -> None:
    assert empty("router", "accounts", "add", "home", "--host", "127.0.0.1").code == 0
    said = empty("router", "--print-config")
    found = json.loads(said.out)
    assert found["mode"] == "router"
    assert found["access_control"]["default_permission"] == "deny"
    tls = found["transport"]["link"]["tls"]
    names = "root_ca_certificate", "listen_private_key", "listen_certificate"
    named = [found["transport"]["auth"]["usrpwd"]["dictionary_file"], *map(tls.get, names)]
    assert all(map(os.path.isfile, named))
    assert "keep the file to yourself" in said.err


def test_zenohs_own_reader_takes_the_printed_settings(empty: Shell, tmp_path: Path) -> None:
    """The one of `zenohd --config`, then a router from it, which a relay uses."""
    listen = "--listen", f"tls/127.0.0.1:{free_port()}"
    made = empty("router", "accounts", "add", "home", *listen, "--host", "127.0.0.1")
    path = tmp_path / "zenohd.json5"
    path.write_text(empty("router", "--print-config").out)
    with zenoh.open(zenoh.Config.from_file(path)):
        asyncio.run(_uses(Routers.read(made.out.encode())))


async def _uses(routers: Routers) -> None:
    carrier = await Carrier.open(routers)
    assert carrier.router == routers.locators[0]
    await carrier.close()
