"""A question and a code: made by commands, as a user would; with real processes it is in
tests/integration/test_console_demo.py.
"""

import io
from pathlib import Path
from typing import Any

import pytest

from rossec.authority.policyfile import parse_policy
from rossec.demo import steps
from rossec.demo.environment import DemoEnvironment, DemoFailed, StepPrinter
from rossec.demo.steps import POLICY, ask, show_code


def demo_in(root: Path, commands: list[list[str]]) -> DemoEnvironment:
    def run(arguments: Any, _: Any) -> int:
        commands.append(list(arguments))
        return 0

    return DemoEnvironment(root, StepPrinter(io.StringIO().write), {}, run)


def test_the_policy_asks_a_person_and_names_everybody() -> None:
    policy = parse_policy(POLICY, "policy.yaml")
    assert policy.defaults.decision == "prompt"
    assert policy.rules == ()
    assert policy.titles["/doctor"] == "Dr. Meier"
    assert policy.titles.keys() >= policy.types.keys()


async def test_a_lamp_asks(tmp_path: Path) -> None:
    (tmp_path / "ca").mkdir()
    commands: list[list[str]] = []
    await ask(demo_in(tmp_path, commands))
    assert (tmp_path / "ca" / "policy.yaml").read_text() == POLICY
    assert [each[:2] for each in commands] == [
        ["node", "request"],
        ["ca", "sign"],
        ["node", "install"],
        ["grant", "request"],
    ]
    assert commands[-1][2:5] == ["/lamp", "--subscribe", "/robot/pose"]


async def test_a_fridge_shows_its_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    waiting = await show_code(demo_in(tmp_path, []))
    try:
        assert waiting.code.startswith("ROSSEC:")
        assert waiting.environment.root == tmp_path / "fridge"
    finally:
        await waiting.environment.stop_all()
    monkeypatch.setattr(steps, "FRIDGE", "no name")
    (tmp_path / "other").mkdir()
    with pytest.raises(DemoFailed, match="fridge"):
        await show_code(demo_in(tmp_path / "other", []))
