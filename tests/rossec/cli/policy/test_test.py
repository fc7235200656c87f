"""`rossec policy test`: transcripts."""

import json
from pathlib import Path

import pytest

from tests.support.commands import Shell

TEXT = """rossec: 1
robot: r
rules:
  - {id: drive, who: /robot, allow: {publish: /cmd_vel}}
tests:
  - {who: /robot, may: {publish: /cmd_vel}}
  - {who: /guest, may_not: {publish: /**}}
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "policy.yaml"
    path.write_text(TEXT)
    return path


def test_assertions_that_hold(shell: Shell, file: Path) -> None:
    assert shell("policy", "test", str(file)).out == "assertions that hold: 2\n"
    assert shell("policy", "check", str(file)).out == f"{file} is right; rules: 1, tests that hold: 2\n"
    rows = json.loads(shell("policy", "test", str(file), "--json").out)
    assert [row["holds"] for row in rows] == [True, True]
    assert rows[0]["rules"] == ["drive"]


def test_a_failure_says_which_rule_decided_and_what_is_needed(shell: Shell, file: Path) -> None:
    file.write_text(TEXT.replace("who: /robot, allow", "who: '*', allow"))
    said = shell("policy", "test", str(file))
    assert (said.code, said.out) == (1, "")
    lines = said.err.splitlines()
    assert lines[0].endswith(f"{file}:7: /guest may publish /cmd_vel: rule drive, line 4")
    assert lines[1] == "rossec: hint: take /cmd_vel out of drive, or deny it"
    assert lines[2] == f"rossec: error: 1 of 2 assertions of {file} do not hold"
    said = shell("policy", "test", str(file), "--json")
    assert said.code == 1
    assert [row["holds"] for row in json.loads(said.out)] == [True, False]
    said = shell("policy", "check", str(file))
    assert (said.code, said.out) == (1, "")
    assert said.err.splitlines()[0].endswith(f"{file}:7:1: /guest may publish /cmd_vel: rule drive, line 4")
    [row] = json.loads(shell("policy", "check", str(file), "--json").out)
    assert {"line", "column", "message", "hint", "file"} == row.keys()


def test_a_policy_without_tests(shell: Shell, file: Path) -> None:
    file.write_text(TEXT.partition("tests:")[0])
    assert shell("policy", "test", str(file)).out == f"{file} has no tests\n"
