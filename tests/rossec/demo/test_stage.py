import asyncio
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from rossec.cli.main import run
from rossec.demo.stage import DemoFailed, Narrator, Stage


@pytest.fixture
def told() -> list[str]:
    return []


@pytest.fixture
async def stage(tmp_path: Path, told: list[str]) -> AsyncIterator[Stage]:
    stage = Stage(tmp_path, Narrator(told.append), {"X": "1"}, run)
    yield stage
    await stage.clear()


def test_steps_are_numbered_and_timed(told: list[str]) -> None:
    narrator = Narrator(told.append)
    with narrator.step("first"):
        narrator.tell("one\ntwo")
    with pytest.raises(ValueError, match="boom"), narrator.step("second"):
        raise ValueError("boom")
    assert told[:3] == ["\n 1. first\n", "    one\n", "    two\n"]
    assert told[3].startswith("    done in 0.")
    assert told[4:] == ["\n 2. second\n"]


async def test_commands_are_shown_as_typed(stage: Stage, told: list[str]) -> None:
    said = await stage.command("node", "request", "/robot")
    assert told[0] == "    $ rossec node request /robot\n"
    assert "request of /robot: $ROSSEC_HOME/nodes/robot/node.csr" in told[1]
    assert str(stage.root) in said
    await stage.command("node", "code", "/robot", quiet=True)
    assert told[-1] == "    $ rossec node code /robot\n"


async def test_a_failed_command_ends_the_demo(stage: Stage) -> None:
    with pytest.raises(DemoFailed, match=r"rossec node show failed: rossec: error: /robot has no"):
        await stage.command("node", "show", "/robot")


async def test_an_actor_reports(stage: Stage) -> None:
    script = stage.root / "site"
    script.mkdir()
    actor = await stage.actor("json.tool", "--json-lines", "--no-indent", "/dev/null", name="quiet")
    with pytest.raises(DemoFailed, match="quiet: a word did not happen; it said: nothing"):
        await actor.expect("a word", bool)
    assert actor.ended


async def test_an_actor_that_never_says_it(stage: Stage) -> None:
    actor = await stage.actor("http.server", "0", "--bind", "127.0.0.1", name="server")
    with pytest.raises(DemoFailed, match="server: a word did not happen"):
        await actor.expect("a word", bool, within=0.2)
    assert not actor.ended


async def test_an_actor_that_does_not_end_is_killed(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    actor = await stage.actor("http.server", "0", "--bind", "127.0.0.1", name="stubborn")
    monkeypatch.setattr(actor._process, "terminate", lambda: None)
    monkeypatch.setattr("rossec.demo.stage.PATIENCE", 0.1)
    async with asyncio.timeout(30):
        await actor.stop()
    assert actor.ended


async def test_what_an_actor_logs_is_quoted(stage: Stage) -> None:
    actor = await stage.actor("rossec", "node", "show", "/robot", name="rossec")
    with pytest.raises(DemoFailed, match="next: rossec node request /robot"):
        await actor.expect("a word", bool)
    assert actor.about("/robot") == []
