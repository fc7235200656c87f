"""The story with real processes is in tests/integration/test_console_demo.py."""

import io
from collections.abc import Callable
from pathlib import Path

import pytest

from rossec.demo import steps
from rossec.demo import steps as trying
from rossec.demo.environment import DemoEnvironment, DemoFailed, Report, StepPrinter
from rossec.demo.steps import begin_story


class Started:
    """A process that reports one line."""

    def __init__(self, report: Report) -> None:
        self._report = report

    async def expect(self, what: str, wanted: Callable[[Report], bool], *, within: float) -> Report:
        assert within >= 30
        if not wanted(self._report):
            raise DemoFailed(f"{what} did not happen")
        return self._report


async def begin(
    root: Path, monkeypatch: pytest.MonkeyPatch, reports: dict[str, Report]
) -> tuple[str, dict[str, tuple[str, ...]]]:
    """Begin the story with processes that report so; returns the link and what was started."""
    started: dict[str, tuple[str, ...]] = {}

    async def step(_: DemoEnvironment) -> None:
        started.setdefault("steps", ())

    async def sign(_: DemoEnvironment) -> str:
        return "camera"

    async def processes(_: DemoEnvironment) -> tuple[str, ...]:
        return "robot", "doctor", "heating", "port"

    async def revoke(_: DemoEnvironment, *what: str) -> None:
        started["revoked"] = what

    async def start(_: DemoEnvironment, module: str, *arguments: str, name: str) -> Started:
        started[name] = (module, *arguments)
        return Started(reports[name])

    for name, done in (
        ("found_authority", step),
        ("enroll", step),
        ("sign_grants", sign),
        ("start", processes),
        ("revoke", revoke),
    ):
        monkeypatch.setattr(steps, name, done)

    async def ask(_: DemoEnvironment) -> None:
        started["asked"] = ()

    monkeypatch.setattr(trying, "ask", ask)
    monkeypatch.setattr(DemoEnvironment, "start", start)
    demo = DemoEnvironment(root, StepPrinter(io.StringIO().write), {}, lambda *_: 0)
    return await begin_story(demo, 7499), started


READY = {"authority": {"ready": "ca/service.sock"}, "console": {"ready": "x", "login": "link"}}


async def test_the_service_is_unlocked_and_the_console_says_its_link(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    link, started = await begin(tmp_path, monkeypatch, READY)
    assert link == "link"
    assert list(started) == ["steps", "revoked", "asked", "authority", "console"]
    assert started["revoked"] == ("doctor", "camera")
    assert started["console"] == ("rossec", "console", "--json", "--port", "7499")
    arguments = " ".join(started["authority"])
    assert "ca serve" in arguments
    assert "--unlock-for 0" in arguments
    assert "--join-address 127.0.0.1:" in arguments
    assert str(tmp_path / "passphrase") in arguments


async def test_a_service_that_does_not_start_ends_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(DemoFailed, match="starting did not happen"):
        await begin(tmp_path, monkeypatch, {**READY, "authority": {}})
