"""Two masters of one domain as processes: one told to follow, the other killed and stopped."""

import asyncio
import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from grants.model import Right
from rossec.cli.status import ADMIN_SOCKET
from rossec.errors import ConfigurationError
from rossec.master.operation.admin import send_command
from rossec.net.aio import SecureContext, WireProtocol, connect
from rossec.net.rpc.calls import RpcClient
from rossec.saved_statements import DomainFiles
from tests.support.masterprocess import MasterProcess
from tests.support.masters import domain_list
from tests.support.site import Site
from tests.support.witness import until

KITCHEN = "/master/kitchen"


class Kitchen(MasterProcess):
    """The second master of the domain, with a home directory beside the first one's."""

    def __init__(self, site: Site) -> None:
        super().__init__(site)
        self.log = site.root / "kitchen.log"
        site.enroll(KITCHEN).save_revocations(site.authority.store.newest_list() or b"")


def federation(master: MasterProcess, *words: str) -> str:
    done = subprocess.run(
        [sys.executable, "-I", "-m", "rossec", "federation", *words],
        env=dict(master.environ),
        capture_output=True,
        text=True,
        timeout=30,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def state(master: MasterProcess) -> dict[str, Any]:
    socket = master.site.enroll("/master").path / ADMIN_SOCKET
    try:
        rows: list[dict[str, Any]] = send_command(socket, "federation")["sites"]
    except ConfigurationError:  # it is just starting
        return {"state": "starting"}
    return rows[0] if rows else {"state": ""}


@pytest.fixture
async def pair(short_path: Path) -> AsyncIterator[tuple[MasterProcess, Kitchen]]:
    site = Site(short_path / "s")
    for name in ("/master", KITCHEN):
        site.enroll(name)
    data = domain_list(site, "/master", KITCHEN)
    for name in ("/master", KITCHEN):
        home = site.enroll(name)
        DomainFiles(home, home.anchor()).save_domains(data)
    hall, kitchen = MasterProcess(site), Kitchen(site)
    try:
        await hall.start("--admin", "--port", str(hall.port))
        await kitchen.start("--name", KITCHEN, "--port", str(kitchen.port))
        yield hall, kitchen
    finally:
        for each in (hall, kitchen):
            if each.process is not None and each.process.returncode is None:
                with contextlib.suppress(ProcessLookupError):
                    each.process.kill()
                await each.process.wait()


async def test_a_site_is_followed_lost_found_again_and_removed(pair: tuple[MasterProcess, Kitchen]) -> None:
    hall, kitchen = pair

    async def until_state(wanted: str, within: float = 20.0) -> None:
        end = time.monotonic() + within
        while (await asyncio.to_thread(state, hall))["state"] != wanted:
            assert time.monotonic() < end, hall.log.read_text()
            await asyncio.sleep(0.1)

    said = await asyncio.to_thread(federation, hall, "add", kitchen.uri, "--as", "kitchen", "--name", KITCHEN)
    assert said.startswith("kitchen is followed")
    await until_state("following")
    assert "kitchen          following" in await asyncio.to_thread(federation, hall, "status")

    site = hall.site
    site.grant("/robot", Right.PUBLISH, "/pose")
    revoked = site.identity("/robot").thumbprint
    await _publish(kitchen, site.revoke(revoked))
    held = site.enroll("/master")
    await until(lambda: held.load_revocations() == site.authority.store.newest_list(), within=5)

    await kitchen.kill()
    await until_state("lost")
    await kitchen.start("--name", KITCHEN, "--port", str(kitchen.port))
    await until_state("following")

    assert kitchen.process is not None
    os.kill(kitchen.process.pid, signal.SIGSTOP)
    await until_state("lost", within=25)
    os.kill(kitchen.process.pid, signal.SIGCONT)
    await until_state("following")

    await hall.kill()
    await hall.start("--admin", "--port", str(hall.port))
    await until_state("following")
    await asyncio.to_thread(federation, hall, "remove", "kitchen")
    await until_state("")
    assert "Traceback" not in hall.log.read_text() + kitchen.log.read_text()


async def _publish(master: MasterProcess, data: bytes) -> None:
    """Deliver a list to one master, as any node may."""
    home = master.site.enroll("/courier")
    context = SecureContext(home.credentials(), home.anchor().verify)
    stream = await connect("127.0.0.1", master.port, context, WireProtocol.HTTP)
    try:
        await RpcClient(stream).ask("rossec.updateRevocations", "/courier", data)
    finally:
        await stream.close()
