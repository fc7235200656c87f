"""What a program of the built-in node shows when a refusal ends it."""

import subprocess
import sys
from pathlib import Path

import pytest

from rossec.errors import ConfigurationError
from rossec.node import node

PROGRAM = """
import asyncio
from rossec.node import Node

async def main():
    async with asyncio.TaskGroup() as tasks:
        tasks.create_task(one())

async def one():
    async with Node("/robot", environ={"ROSSEC_HOME": HOME}):
        pass

asyncio.run(WAY())
"""


def ended(home: Path, way: str, *options: str) -> str:
    program = PROGRAM.replace("HOME", repr(str(home))).replace("WAY", way)
    command = [sys.executable, *options, "-c", program]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    return done.stderr


@pytest.mark.parametrize("way", ["one", "main"])
def test_error_and_hint_instead_of_a_traceback(tmp_path: Path, way: str) -> None:
    lines = ended(tmp_path, way).splitlines()
    assert lines[0].startswith("rossec: error: /robot has no ")
    assert lines[1].startswith("rossec: hint: ")
    assert lines[1].endswith("next: rossec node request /robot")
    assert len(lines) == 2


def test_developers_get_the_traceback(tmp_path: Path) -> None:
    assert "Traceback" in ended(tmp_path, "one", "-X", "dev")


def test_any_other_exception_keeps_its_traceback(capsys: pytest.CaptureFixture[str]) -> None:
    refusal = ConfigurationError("no", "do so")
    for error in (ValueError("x"), ExceptionGroup("two", [refusal, ValueError("x")])):
        node.show(type(error), error, None)
        assert "ValueError: x" in capsys.readouterr().err
    group = ExceptionGroup("two", [refusal, ExceptionGroup("more", [refusal])])
    node.show(type(group), group, None)
    assert capsys.readouterr().err == "rossec: error: no\nrossec: hint: do so\n" * 2


def test_a_program_keeps_a_hook_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "excepthook", print)
    node.install()
    assert sys.excepthook is print
    monkeypatch.setattr(sys, "excepthook", sys.__excepthook__)
    node.install()
    assert sys.excepthook is node.show
