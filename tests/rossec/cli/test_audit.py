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
    path.write_text("x")
    refused(shell("audit"), "line 1 of the audit is damaged", "backup")
    refused(shell("audit", "/nowhere"), "there is no /nowhere", "has the master run")
