import asyncio
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from rossec.cli.main import run
from rossec.demo.environment import DemoEnvironment, DemoFailed, StepPrinter


@pytest.fixture
def printed() -> list[str]:
    return []


@pytest.fixture
async def demo(tmp_path: Path, printed: list[str]) -> AsyncIterator[DemoEnvironment]:
    demo = DemoEnvironment(tmp_path, StepPrinter(printed.append), {"X": "1"}, run)
    yield demo
    await demo.stop_all()


def test_steps_are_numbered_and_timed(printed: list[str]) -> None:
    printer = StepPrinter(printed.append)
    with printer.step("first"):
        printer.print("one\ntwo")
    with pytest.raises(ValueError, match="boom"), printer.step("second"):
        raise ValueError("boom")
    assert printed[:3] == ["\n 1. first\n", "    one\n", "    two\n"]
    assert printed[3].startswith("    done in 0.")
    assert printed[4:] == ["\n 2. second\n"]


async def test_commands_are_shown_as_typed(demo: DemoEnvironment, printed: list[str]) -> None:
    said = await demo.command("node", "request", "/robot")
    assert printed[0] == "    $ rossec node request /robot\n"
    assert "request of /robot: $ROSSEC_HOME/nodes/robot/node.csr" in printed[1]
    assert str(demo.root) in said
    await demo.command("node", "code", "/robot", quiet=True)
    assert printed[-1] == "    $ rossec node code /robot\n"


async def test_a_failed_command_ends_the_demo(demo: DemoEnvironment) -> None:
    with pytest.raises(DemoFailed, match=r"rossec node show failed: rossec: error: /robot has no"):
        await demo.command("node", "show", "/robot")


async def test_a_process_reports(demo: DemoEnvironment) -> None:
    script = demo.root / "site"
    script.mkdir()
    process = await demo.start("json.tool", "--json-lines", "--no-indent", "/dev/null", name="quiet")
    with pytest.raises(DemoFailed, match="quiet: a word did not happen; it logged: nothing"):
        await process.expect("a word", bool)
    assert process.ended


async def test_a_process_without_the_report(demo: DemoEnvironment) -> None:
    process = await demo.start("http.server", "0", "--bind", "127.0.0.1", name="server")
    with pytest.raises(DemoFailed, match="server: a word did not happen"):
        await process.expect("a word", bool, within=0.2)
    assert not process.ended


async def test_a_process_that_does_not_end_is_killed(
    demo: DemoEnvironment, monkeypatch: pytest.MonkeyPatch
) -> None:
    process = await demo.start("http.server", "0", "--bind", "127.0.0.1", name="stubborn")
    monkeypatch.setattr(process._process, "terminate", lambda: None)
    monkeypatch.setattr("rossec.demo.environment.PATIENCE", 0.1)
    async with asyncio.timeout(30):
        await process.stop()
    assert process.ended


async def test_the_log_of_a_process_is_quoted(demo: DemoEnvironment) -> None:
    process = await demo.start("rossec", "node", "show", "/robot", name="rossec")
    with pytest.raises(DemoFailed, match="next: rossec node request /robot"):
        await process.expect("a word", bool)
    assert process.about("/robot") == []


async def test_a_line_of_a_log_is_waited_for(demo: DemoEnvironment) -> None:
    process = await demo.start("rossec", "node", "show", "/robot", name="rossec")
    assert await process.logged(r"rossec: hint: .*") != ""
    with pytest.raises(DemoFailed, match="rossec said nothing expected: rossec: error"):
        await process.logged("no such line", within=5)
    await process.wait()


async def test_the_first_process_that_ends_ends_the_demo(demo: DemoEnvironment) -> None:
    demo.set("X", "2")
    await demo.start("http.server", "0", "--bind", "127.0.0.1", name="server")
    await demo.start("rossec", "node", "show", "/robot", name="rossec")
    with pytest.raises(DemoFailed, match="rossec has ended; it logged: rossec: error"):
        await demo.until_one_ends()
