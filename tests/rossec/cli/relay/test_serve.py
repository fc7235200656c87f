"""`rossec relay` and `rossec relay status`: two relays as processes, a router between them."""

import asyncio
import json
import os
import signal
import sys
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path

import pytest

from rossec.overlay.documents import OPEN_ACCOUNT, Routers
from tests.support.commands import Shell, refused
from tests.support.overlay import router
from tests.support.ports import free_port
from tests.support.relayedsites import RelayedSite, Wires
from tests.support.site import Site
from tests.support.witness import until


class RelayProcess:
    """`rossec relay` of a site."""

    def __init__(self, site: RelayedSite, process: asyncio.subprocess.Process, log: Path) -> None:
        self.site, self.process, self._log = site, process, log

    def said(self) -> str:
        return self._log.read_text()

    async def run(self, *words: str) -> str:
        process = await asyncio.create_subprocess_exec(
            sys.executable,
            "-m",
            "rossec",
            "relay",
            *words,
            env=environ(self.site),
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
        )
        out, err = await process.communicate()
        assert process.returncode == 0, err.decode() + self.said()
        return out.decode()


def environ(site: RelayedSite) -> dict[str, str]:
    kept = {key: value for key, value in os.environ.items() if not key.startswith("ROS")}
    return {
        **kept,
        "ROSSEC_HOME": str(site.site.root),
        "ROS_MASTER_URI": site.master.server.uri,
        "ROS_IP": "127.0.0.1",
    }


@asynccontextmanager
async def relay_of(site: RelayedSite, *options: str, says: str = "/relay") -> AsyncIterator[RelayProcess]:
    log = site.site.root / "relay.log"
    with log.open("wb") as file:
        process = await asyncio.create_subprocess_exec(
            sys.executable,
            "-m",
            "rossec",
            "relay",
            *options,
            env=environ(site),
            stdin=asyncio.subprocess.DEVNULL,
            stdout=file,
            stderr=file,
        )
    found = RelayProcess(site, process, log)
    try:
        await until(lambda: process.returncode is not None or says in found.said())
        yield found
    finally:
        if process.returncode is None:
            process.send_signal(signal.SIGTERM)
            await process.wait()
        assert "Traceback" not in found.said()


async def test_two_relays_carry_a_connection_through_a_router(short_path: Path) -> None:
    wires = Wires()
    home, office = (RelayedSite(short_path / each, each, wires) for each in ("home", "office"))
    async with AsyncExitStack() as stack:
        locator = stack.enter_context(router())
        for one, other in ((home, office), (office, home)):
            one.trust(other)
            await one.master.start()
            stack.push_async_callback(one.master.stop)
            one.files.keep_account(Routers((locator,), OPEN_ACCOUNT).write())
        at_home = await stack.enter_async_context(relay_of(home, "--json"))
        at_office = await stack.enter_async_context(relay_of(office))
        assert json.loads(at_home.said()) == {"ready": "/relay", "router": locator}
        assert f"relay /relay of office at {locator}" in at_office.said()
        assert "it has no peers yet" in at_office.said()
        assert "no relay of another site is known" not in await at_home.run("status")
        lists = [each.files.home.path / "domains.cose" for each in (home, office)]
        await until(lambda: all(each.exists() for each in lists))
        for here, there in ((at_home, at_office), (at_office, at_home)):
            descriptor = short_path / "descriptor"
            descriptor.write_text(await there.run("descriptor", here.site.label))
            await here.run("add", there.site.label, str(descriptor))
        forwarded_port = await home.forwarded_port("office", "master", "/master")
        stream = await home.through(forwarded_port)
        assert stream.peer.name == "/remote/office/master"
        (peer,) = json.loads(await at_home.run("status", "--json"))["peers"]
        assert (peer["label"], peer["state"], peer["streams"]) == ("office", "linked", 1)
        assert peer["rtt_ms"] > 0
        lines = (await at_office.run("status")).splitlines()
        assert lines[0] == f"/relay of office, account open at {locator}, 0 forwarded ports"
        assert lines[1] == "/master: polled for forwarded ports"
        assert "1 connections, 1 links from it" in lines[2]
        await stream.close()


async def test_a_relay_waits_for_its_routers(short_path: Path) -> None:
    site = RelayedSite(short_path / "home", "home", Wires())
    site.trust()
    await site.master.start()
    locator = f"tcp/127.0.0.1:{free_port()}"
    site.files.keep_account(Routers((locator,), OPEN_ACCOUNT).write())
    async with relay_of(site, "--bind", "127.0.0.1", says="trying again") as waiting:
        assert f"no router takes the account open: {locator}" in waiting.said()
        with router(locator):
            await until(lambda: f"relay /relay of home at {locator}" in waiting.said())
    async with relay_of(site, says="trying again") as ended:
        pass
    assert ended.process.returncode == 0
    await site.master.stop()


def test_a_relay_that_cannot_run(empty: Shell) -> None:
    refused(empty("relay"), "/relay has no ca.pem", "rossec node request /relay")
    Site(empty.root).enroll("/relay")
    refused(empty("relay"), "/relay has no account at a router", "rossec relay account FILE")
    refused(empty("relay", "--account", str(empty.root / "x")), "there is no", "rossec router accounts")
    refused(empty("relay", "status"), "the relay does not answer", "rossec relay")


@pytest.mark.parametrize("forwarded_ports", ["nowhere.invalid", "192.0.2.1"])
def test_forwarded_ports_are_at_an_address_of_this_host(empty: Shell, forwarded_ports: str) -> None:
    home = Site(empty.root).enroll("/relay")
    account = home.path / "account.json"
    account.touch(0o600)
    account.write_bytes(Routers(("tcp/127.0.0.1:9",), OPEN_ACCOUNT).write())
    refused(
        empty("relay", "--bind", forwarded_ports),
        f"{forwarded_ports} is not an address of this host",
        "--bind",
    )
