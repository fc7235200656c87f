"""`rossec master` as a service: configuration, metrics, status, stop, and its audit."""

import asyncio
import contextlib
import json
import os
import re
import socket
import sys
import urllib.request
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from rossec.cli.main import run
from rossec.errors import AnswerRefused
from tests.integration.test_master_killed import T, client_of
from tests.support.masterprocess import MasterProcess, master_process
from tests.support.witness import until

CONFIG = "log: json\nadmin: true\nmetrics: 0\nlimits:\n  connections_per_identity: 3\n"


@pytest.fixture
async def master(tmp_path: Path) -> AsyncIterator[tuple[MasterProcess, socket.socket]]:
    config = tmp_path / "master.yaml"
    config.write_text(CONFIG)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(tmp_path / "notify"))
        manager.settimeout(30)
        async with master_process(tmp_path / "site") as found:
            variables = {"NOTIFY_SOCKET": str(tmp_path / "notify")}
            await found.start("--config", str(config), **variables)
            yield found, manager


def command(master: MasterProcess, capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    capsys.readouterr()
    code = run(words, master.environ)
    out, err = capsys.readouterr()
    return code, out, err


async def test_a_master_is_started_asked_and_stopped(
    master: tuple[MasterProcess, socket.socket], capsys: pytest.CaptureFixture[str]
) -> None:
    service, manager = master

    async def rossec(*words: str) -> tuple[int, str, str]:
        return await asyncio.to_thread(command, service, capsys, *words)

    assert await asyncio.to_thread(manager.recv, 100) == b"READY=1"
    eve = await client_of(service, "/eve")
    with pytest.raises(AnswerRefused):
        await eve.ask("registerPublisher", "/eve", "/cmd_vel", T, "http://127.0.0.1:9/")
    code, out, _ = await rossec("master", "status", "--json")
    status: dict[str, Any] = json.loads(out)
    assert (code, status["uri"], status["denials"], status["nodes"]) == (0, service.uri, 1, 0)
    assert "denials              1" in (await rossec("master", "status"))[1]
    found = re.search(r"metrics at (http://127.0.0.1:\d+/metrics)", service.log.read_text())
    assert found is not None
    page = await asyncio.to_thread(urllib.request.urlopen, found[1], None, 10)
    with page:
        assert b"rossec_master_denials_total 1.0" in page.read()

    assert service.process is not None
    code, out, _ = await rossec("master", "stop")
    assert (code, out) == (0, "the master ends\n")
    async with asyncio.timeout(30):
        assert await service.process.wait() == 0
    assert await asyncio.to_thread(manager.recv, 100) == b"STOPPING=1"
    with contextlib.suppress(Exception):
        await eve.close()
    lines = [line for line in service.log.read_text().splitlines() if line.startswith("{")]
    logged = [json.loads(line) for line in lines]
    assert any("/eve may not publish" in entry["text"] for entry in logged)

    code, out, err = await rossec("audit", "--verify")
    assert code == 0
    assert "nothing was changed in" in err
    for text in ("the master began", "/eve may not publish", "asks for stop", "ended"):
        assert text in out
    code, out, _ = await rossec("audit", "--json", "--since", str(1 << 40))
    assert (code, out) == (0, "")
    audit = service.site.enroll("/master").path / "audit.log"
    audit.write_text(audit.read_text().replace("/eve", "/bob"))
    code, _, err = await rossec("audit", "--verify")
    assert code == 1
    assert "was changed" in err
    code, _, err = await rossec("audit", "/nowhere")
    assert (code, "there is no /nowhere" in err) == (1, True)


async def test_a_signal_ends_the_master_in_order(tmp_path: Path) -> None:
    async with master_process(tmp_path / "site") as master:
        await master.start()
        assert await master.terminate() == 0
        await until(lambda: not master.site.root.joinpath("nodes/master/admin.sock").exists())


def test_a_wrong_configuration_is_refused_with_its_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = tmp_path / "master.yaml"
    config.write_text("port: 11311\nadmn: true\n")
    code = run(["master", "--config", str(config)], {"ROSSEC_HOME": str(tmp_path)})
    assert code == 1
    assert f"{config}:2: there is no setting 'admn'" in capsys.readouterr().err


async def another(master: MasterProcess, *options: str) -> tuple[int | None, str]:
    """Another `rossec master` of the same home; its exit code and output."""
    base = {key: value for key, value in os.environ.items() if not key.startswith("ROS")}
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        "-I",
        "-m",
        "rossec",
        "master",
        *options,
        env={**base, **master.environ},
        stderr=asyncio.subprocess.PIPE,
    )
    async with asyncio.timeout(60):
        _, err = await process.communicate()
    return process.returncode, err.decode()


async def test_a_second_master_is_refused_and_harms_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    async with master_process(tmp_path / "site") as master:
        await master.start()
        code, err = await another(master, "--port", "0")
        assert (code, "another master runs from" in err) == (1, True)
        await master.terminate()
        with socket.create_server(("127.0.0.1", master.port)):
            code, err = await another(master)
        assert code == 1
        assert f"cannot listen on port {master.port}: address already in use" in err
        assert "is a master running already?" in err
        code, out, err = await asyncio.to_thread(command, master, capsys, "audit", "--verify")
        assert (code, out.count("the master began"), out.count("ended")) == (0, 1, 1)
