"""`rossec audit` over a file that a master has written."""

import json
import logging
from pathlib import Path

import pytest

from rossec.master.audit import AuditFile
from tests.support.commands import Shell, refused


@pytest.fixture
def shell(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Shell:
    shell = Shell(tmp_path / "home", capsys)
    shell.node("/master").mkdir(parents=True)
    now = [1000.0]
    file = AuditFile(shell.node("/master") / "audit.log", lambda: now[0])
    for text in ("one", "two\x1b[0m"):
        file.emit(logging.makeLogRecord({"msg": text}))
        now[0] += 1000
    file.close()
    return shell


def test_it_is_shown_to_people_and_programs(shell: Shell) -> None:
    said = shell("audit")
    assert said.code == 0
    assert said.out.splitlines()[0] == "1970-01-01 00:16:40 UTC  one"
    assert "\x1b" not in said.out
    [line] = shell("audit", "--json", "--since", "1500").out.splitlines()
    assert json.loads(line)["text"] == "two\\u001b[0m"


def test_a_change_is_noticed(shell: Shell) -> None:
    assert "nothing was changed in 2 lines; the last is " in shell("audit", "--verify").err
    path = shell.node("/master") / "audit.log"
    path.write_text(path.read_text().replace("one", "won"))
    refused(shell("audit", "--verify"), "line 1 of the audit was changed")


def test_damage_hides_nothing_else(shell: Shell) -> None:
    path = shell.node("/master") / "audit.log"
    one, two = path.read_text().splitlines()
    path.write_text(f"{one}\nx\n{two}\n")
    said = shell("audit")
    assert (said.code, len(said.out.splitlines())) == (0, 2)
    assert f"line 2 of {path} is damaged and not shown" in said.err
    refused(shell("audit", "--verify"), f"line 2 of {path} is damaged", "backup")


def test_no_file_and_what_was_left_out(shell: Shell) -> None:
    refused(shell("audit", "/nowhere"), "there is no /nowhere", "has the master run")
    file = AuditFile(shell.root / "other.log")
    file.emit(logging.makeLogRecord({"msg": "denied", "left_out": 3}))
    file.close()
    with (shell.root / "other.log").open("a") as torn:
        torn.write("torn")
    file = AuditFile(shell.root / "other.log")
    file.emit(logging.makeLogRecord({"msg": "next"}))
    file.close()
    one, two = shell("audit", str(shell.root / "other.log")).out.splitlines()
    assert one.endswith("denied (3 lines like it before it were left out)")
    assert two.endswith("next (4 bytes before it were cut short)")
