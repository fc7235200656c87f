"""`rossec gateway` as a process whose master follows nobody: what it says, and when it ends."""

import asyncio
import os
import signal
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from grants.model import Right
from rossec.cli import gateway as module
from rossec.cli.shared.context import Environment
from rossec.errors import ConfigurationError, MasterNotFound
from rossec.host import runner
from rossec.ros.names import parse_uri
from tests.support.commands import Shell, refused
from tests.support.discovered import Searches
from tests.support.site import Site
from tests.support.trust import accept, carry, share
from tests.support.witness import until

RULE = ("--from", "ada", "/robot/**")


class Ran:
    """A gateway's process and what it says."""

    def __init__(self, process: asyncio.subprocess.Process, log: Path) -> None:
        self.process, self._log = process, log

    def said(self) -> str:
        return self._log.read_text()


@asynccontextmanager
async def gateway(site: Site, *words: str, says: str, **variables: str) -> AsyncIterator[Ran]:
    kept = {key: value for key, value in os.environ.items() if not key.startswith("ROS")}
    environ = {**kept, **site.environ, **variables}
    log = site.root / f"gateway{len(list(site.root.glob('gateway*.log')))}.log"
    with log.open("wb") as file:
        process = await asyncio.create_subprocess_exec(
            sys.executable,
            "-m",
            "rossec",
            "gateway",
            *words,
            env=environ,
            stdin=asyncio.subprocess.DEVNULL,
            stdout=file,
            stderr=file,
        )
    ran = Ran(process, log)
    try:
        await until(lambda: process.returncode is not None or says in ran.said())
        assert says in ran.said()
        yield ran
    finally:
        if process.returncode is None:
            process.send_signal(signal.SIGTERM)
            await process.wait()
        assert "Traceback" not in ran.said()


@pytest.fixture
async def site(short_path: Path) -> AsyncIterator[Site]:
    """A home that trusts the domain `ada`, with a gateway that nobody has granted anything."""
    home, ada = Site(short_path / "home"), Site(short_path / "ada", "ada")
    home.enroll("/gateway")
    accept(home, ada)
    accept(ada, home)
    carry(home)
    async with home.running():
        yield home


async def test_it_says_what_it_lacks_and_ends_with_a_signal(site: Site) -> None:
    async with gateway(site, *RULE, says="gateway /gateway serves topics of ada") as running:
        assert "ada has granted /gateway nothing yet" in running.said()
        assert "there: rossec grant sign US:/gateway" in running.said()
        assert "--subscribe /robot/**" in running.said()
        await until(lambda: "rossec grant sign /gateway --graph" in running.said())
        async with gateway(site, *RULE, says="/gateway runs already") as second:
            assert await second.process.wait() == 1
    assert running.process.returncode == 0


async def test_a_gateway_with_grants_says_that_it_is_ready(site: Site, short_path: Path) -> None:
    ada = Site(short_path / "other", "ada2")
    accept(site, ada, "ada2")
    accept(ada, site)
    carry(site)
    share(ada, site, "/gateway", Right.SUBSCRIBE, "/robot/**")
    site.grant("/gateway", Right.GRAPH, "/**")
    async with gateway(site, "--json", "--from", "ada2", "/robot/*", says="ready") as running:
        assert running.said().endswith('{"ready": "/gateway"}\n')
        assert "has granted" not in running.said()


async def test_a_gateway_waits_for_its_master(site: Site) -> None:
    assert site.master is not None
    uri = site.master.uri
    await site.master.close()
    waits = {"says": "trying again", "ROS_MASTER_URI": uri}
    async with gateway(site, *RULE, **waits) as stopped:
        pass
    assert stopped.process.returncode == 0
    async with gateway(site, *RULE, **waits) as running:
        await site.start_master(parse_uri(uri)[1])
        await until(lambda: "gateway /gateway serves" in running.said())


def test_what_is_wrong_on_this_host_is_no_master_to_wait_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unreadable(*_: object, **__: object) -> None:
        raise PermissionError("node.key")

    site = Site(tmp_path / "site")
    site.enroll("/gateway")
    monkeypatch.setattr(module, "node_as", unreadable)
    with pytest.raises(PermissionError):
        module.run(Environment(site.environ), (), as_json=False)


async def test_a_domain_that_is_not_trusted_is_refused(site: Site) -> None:
    async with gateway(site, "--from", "eve", "/x", says="no trusted domain is called eve") as ran:
        assert "rossec domain accept BUNDLE --as eve" in ran.said()
        assert await ran.process.wait() == 1


def test_a_gateway_that_is_not_enrolled_is_refused(empty: Shell) -> None:
    refused(empty("gateway", *RULE), "/gateway has no ca.pem", "rossec node request /gateway")


def test_a_gateway_waits_for_a_master_that_is_not_announced_yet(
    tmp_path: Path, searches: Searches, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    site = Site(tmp_path / "site")
    site.enroll("/gateway")
    searches.result = MasterNotFound("no master announces itself", "start it")
    monkeypatch.setattr(runner, "AGAIN_AFTER", 0.01)
    made: list[int] = []

    async def end_after_the_third(*given: Any, **more: Any) -> Any:
        made.append(1)
        if len(made) == 3:
            raise ConfigurationError("enough")
        return await Searches.discover(searches, *given, **more)

    monkeypatch.setattr("rossec.discovery.discover_master", end_after_the_third)
    environ = {**site.environ, "ROS_MASTER_URI": "discover:"}
    with pytest.raises(ConfigurationError, match="enough"):
        module.run(Environment(environ), (), as_json=False)
    assert len(made) == 3
    assert caplog.text.count("no master yet, trying again: no master announces itself") == 1
