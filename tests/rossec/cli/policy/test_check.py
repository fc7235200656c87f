"""`rossec policy check | lint`: transcripts."""

import json
from pathlib import Path

import pytest

from tests.grants.policy.policies import SMALL
from tests.support.commands import Shell


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "policy.yaml"
    path.write_text(SMALL)
    return path


def test_a_valid_policy_is_accepted(shell: Shell, file: Path) -> None:
    assert shell("policy", "check", str(file)).out == f"{file} is right; rules: 4\n"
    assert shell("policy", "check", str(file), "--json").out == "[]\n"


def test_every_mistake_is_printed_with_its_hint(shell: Shell, file: Path) -> None:
    text = SMALL.replace("pose.position:", "pose.positon:").replace("who: heating", "who: heting")
    file.write_text(text)
    said = shell("policy", "check", str(file))
    assert (said.code, said.out) == (1, "")
    lines = said.err.splitlines()
    assert lines[0].startswith(f"rossec: error: {file}:10:5: geometry_msgs/PoseStamped: pose.positon")
    assert lines[1] == "rossec: hint: did you mean 'position'?"
    assert lines[2] == f"rossec: error: {file}:15:10: unknown identity 'heting'"
    assert lines[3] == "rossec: hint: did you mean 'heating'?"
    assert lines[-2] == f"rossec: error: {file} is not a policy"
    found = json.loads(shell("policy", "check", str(file), "--json").out)
    assert {"line", "column", "message", "hint", "file"} == found[0].keys()


def test_findings_are_printed_with_their_codes_and_number(shell: Shell, file: Path) -> None:
    said = shell("policy", "lint", str(file)).out
    assert "header.stamp is not" in said
    lines = said.splitlines()
    assert f"{file}:13: rule heating-room: pose.position is rounded without hysteresis" in said
    assert "[no-hysteresis]\n  write pose.position: {round: {step: 2.0, hysteresis: 1.0}}\n" in said
    assert lines[-1] == f"{len(lines) // 2} remarks"
    found = json.loads(shell("policy", "lint", str(file), "--json").out)
    assert len(found) == len(lines) // 2
    assert all(item.keys() == {"line", "code", "message", "hint"} for item in found)
    file.write_text("rossec: 1\nrobot: r\nrules: []\n")
    assert shell("policy", "lint", str(file)).out == "nothing to remark\n"
    file.write_text("rossec: 1\nrobot: r\nrules: [{id: d, who: /x, deny: {call: /b}}]\n")
    assert shell("policy", "lint", str(file)).out == (
        f"{file}:3: rule d gives no reason [no-reason]\n  add why: ...\n1 remark\n"
    )
