"""`rossec master` alone; with nodes in tests/integration."""

import asyncio
import json
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from rossec.authority import renewals
from rossec.authority.local_list import LocalList
from rossec.authority.renewals import sign_intermediate
from rossec.cli.status import ADMIN_SOCKET
from rossec.master.operation.admin import send_command
from tests.support.commands import Shell, refused
from tests.support.masterprocess import master_process
from tests.support.site import Site
from tests.support.witness import until


@pytest.fixture
def shell(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Shell:
    return Shell(tmp_path / "home", capsys)


def test_a_wrong_configuration_is_refused(shell: Shell) -> None:
    config = shell.root / "master.yaml"
    config.write_text("log: json\nprot: 1\n")
    refused(shell("master", "--config", str(config)), f"{config}:2: there is no setting", "port")


def test_a_master_that_is_not_enrolled_does_not_start(shell: Shell) -> None:
    refused(shell("master"), "/master has no ca.pem", "rossec node request /master")


def test_the_host_of_an_intermediate_has_no_list_of_its_own(shell: Shell) -> None:
    """Its master waits for the root's, as one on any other host."""
    site = Site(shell.root / "site")
    request = renewals.begin(shell.root, "home", "secret").read_bytes()
    _, bundle = sign_intermediate(site.authority, request, site.now(), may_enroll=False)
    renewals.install(shell.root, bundle, "secret", site.now())
    assert LocalList(shell.root).newest() is None
    refused(shell("master"), "/master has no ca.pem", "rossec node request /master")


_CARRIED = """
import sys
held = set(sys.modules)  # what measures coverage has its own
import rossec.cli.main
import rossec.cli.master
from rossec.net.aio.server import bind
for listener in bind("127.0.0.1", 0):
    listener.close()
heavy = ["numpy", "ruamel", "sqlite3", "zoneinfo", "difflib", "encodings.idna"]
heavy += ["grants.filters.layout", "grants.conditions.compile", "rossec.node"]
print([name for name in heavy if name in sys.modules.keys() - held])
"""


def test_a_master_imports_no_module_of_other_commands() -> None:
    """What it imports is more than two thirds of its memory."""
    command = [sys.executable, "-I", "-c", _CARRIED]
    assert subprocess.run(command, check=True, capture_output=True, text=True).stdout == "[]\n"


async def test_a_master_runs_with_its_ports_until_it_is_stopped(tmp_path: Path) -> None:
    async with master_process(tmp_path / "site") as master:
        options = ("--admin", "--log", "json", "--metrics", "0", "--json")
        await master.start("--port", str(master.port), *options)
        admin = master.site.enroll("/master").path / ADMIN_SOCKET
        await until(lambda: '"ready"' in master.log.read_text())
        status = await asyncio.to_thread(send_command, admin, "status")
        assert status["uri"] == master.uri
        assert await asyncio.to_thread(send_command, admin, "stop") == {"stopping": True}
        assert master.process is not None
        assert await asyncio.wait_for(master.process.wait(), 30) == 0
        log = master.log.read_text()
    said = json.loads(log.splitlines()[0])
    assert said["ready"] == master.uri
    assert said["metrics"].startswith("http://127.0.0.1:")
    assert "the master ended" in log


async def test_a_master_ends_by_a_signal(tmp_path: Path) -> None:
    async with master_process(tmp_path / "site") as master:
        await master.start()
        assert await master.terminate() == 0
        assert master.log.read_text() == f"master of home at {master.uri}\n"


def test_a_taken_port_and_an_address_that_only_this_host_reaches_are_refused(shell: Shell) -> None:
    Site(shell.root / "site").enroll("/master")
    shell.environ["ROSSEC_HOME"] = str(shell.root / "site")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        refused(shell("master", "--port", str(port)), f"cannot listen on port {port}", "--port")
    refused(shell("master", "--port", "0", "--announce"), "cannot be announced", "ROS_IP")


def test_the_root_renews_no_identities_for_a_master(shell: Shell) -> None:
    assert shell.unlocked("ca", "init", "home").code == 0
    shell.enroll("/master")
    said = shell.unlocked("master", "--renew-identities", "--port", "0")
    refused(said, "holds the root, whose service renews identities", "leave it out, and run")
