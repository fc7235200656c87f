"""`rossec policy init`: transcripts."""

import json
from pathlib import Path

from tests.support.commands import Shell, refused


def test_a_policy_is_begun_and_never_overwritten(shell: Shell, tmp_path: Path) -> None:
    file = tmp_path / "policy.yaml"
    said = shell("policy", "init", str(file), "--robot", "our home")
    assert said.out == f"{file} is begun; write rules, then: rossec policy check {file}\n"
    assert "basics: true" in file.read_text()
    assert 'robot: "our home"' in file.read_text()
    assert shell("policy", "check", str(file)).code == 0
    assert shell("policy", "lint", str(file)).out == "nothing to remark\n"
    file.write_text("mine")
    refused(shell("policy", "init", str(file)), "exists and is not overwritten", "move it away")
    assert file.read_text() == "mine"


def test_its_result_for_programs(shell: Shell, tmp_path: Path) -> None:
    file = tmp_path / "policy.yaml"
    assert json.loads(shell("policy", "init", str(file), "--json").out)["file"] == str(file)


def test_it_needs_a_place(shell: Shell, tmp_path: Path) -> None:
    absent = str(tmp_path / "no" / "p.yaml")
    refused(shell("policy", "init", absent), "there is no", "rossec ca init")
    assert "ca/policy.yaml is begun" in shell("policy", "init").out
