"""With real processes: tests/integration/test_console_demo.py."""

import asyncio
import os
import signal
import socket
from pathlib import Path

import pytest

from rossec.cli import demo
from rossec.demo.environment import DemoEnvironment, DemoFailed
from rossec.demo.steps import EnrollingNode
from tests.support.commands import Shell, refused


def play(monkeypatch: pytest.MonkeyPatch, ends: bool) -> list[Path]:
    """A story that only prints; afterwards somebody presses Ctrl-C, or a part `ends`."""
    roots: list[Path] = []

    async def begin_story(demo: DemoEnvironment, port: int) -> str:
        roots.append(demo.root)
        assert port == 7499
        demo.printer.print("begun")
        return "http://localhost:7499/login#code"

    async def until_one_ends(_: DemoEnvironment) -> None:
        if ends:
            raise DemoFailed("robot has ended; it logged: nothing")
        os.kill(os.getpid(), signal.SIGINT)
        await asyncio.Event().wait()

    async def show_code(demo: DemoEnvironment) -> EnrollingNode:
        other = DemoEnvironment(demo.root / "fridge", demo.printer, {}, demo.run)
        return EnrollingNode("ROSSEC:CODE", other)

    monkeypatch.setattr(demo, "show_code", show_code)
    monkeypatch.setattr(demo, "begin_story", begin_story)
    monkeypatch.setattr(DemoEnvironment, "until_one_ends", until_one_ends)
    return roots


def test_it_prints_the_link_and_ends_with_ctrl_c(empty: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    roots = play(monkeypatch, ends=False)
    said = empty("console", "--demo", "--port", "7499")
    assert said.code == 0, said
    assert "    http://localhost:7499/login#code\n" in said.out
    assert f"ROSSEC_HOME={roots[0]} rossec console phone" in said.out
    assert "leaves nothing" in said.out
    below = said.out.partition("http://localhost:7499/login#code")[2]
    assert "ROSSEC:CODE" in below
    assert f"ROSSEC_HOME={roots[0] / 'fridge'} rossec node confirm /fridge" in below
    assert not roots[0].exists()


def test_a_part_that_ends_is_said(empty: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    roots = play(monkeypatch, ends=True)
    refused(empty("console", "--demo", "--port", "7499"), "robot has ended")
    assert not roots[0].exists()


def test_it_takes_a_port_and_nothing_else(empty: Shell) -> None:
    refused(empty("console", "--demo", "--read-only"), "--demo is for localhost", "--port")


def test_a_port_in_use_is_said_before_the_story_begins(empty: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    roots = play(monkeypatch, ends=False)
    with socket.create_server(("127.0.0.1", 0)) as used:
        port = str(used.getsockname()[1])
        refused(empty("console", "--demo", "--port", port), "already in use", "--port N")
    assert roots == []
