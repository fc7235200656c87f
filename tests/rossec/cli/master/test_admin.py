import asyncio
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from rossec.cli.status import ADMIN_SOCKET
from rossec.master.operation.admin import AdminPort, Commands
from tests.support.commands import Shell, refused


@pytest.fixture
def shell(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Shell:
    return Shell(tmp_path / "home", capsys)


def test_without_a_running_master_there_is_no_answer(shell: Shell) -> None:
    shell.node("/master").mkdir(parents=True)
    for verb in ("status", "stop"):
        said = shell("master", verb)
        refused(said, "the master does not answer", "--admin")
        assert "Errno" not in said.err


def test_where_no_master_is_the_home_is_doubted(shell: Shell) -> None:
    shell.node("/other").mkdir(parents=True)
    (shell.node("/other") / "node.key").touch()
    for verb in ("status", "stop"):
        refused(shell("master", verb), "there is no /master in ", "here are: /other")


async def test_the_running_master_is_asked_at_its_socket(shell: Shell) -> None:
    stopped: list[bool] = []

    def stop() -> Mapping[str, Any]:
        stopped.append(True)
        return {"stopping": True}

    shell.node("/master").mkdir(parents=True)
    commands: Commands = {"status": lambda: {"uri": "http://h:1/", "open_connections": 3}, "stop": stop}
    port = AdminPort(shell.node("/master") / ADMIN_SOCKET, commands)
    await port.start()
    try:
        said = [
            await asyncio.to_thread(shell, "master", *words)
            for words in (("status",), ("status", "--json"), ("stop",))
        ]
    finally:
        await port.close()
    assert said[0].out.splitlines()[1] == "open connections     3"
    assert said[1].out == '{"open_connections": 3, "uri": "http://h:1/"}\n'
    assert (said[2].out, stopped) == ("the master ends\n", [True])
