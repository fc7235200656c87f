"""`rossec audit` over a file that a master has written."""

import json
import logging
import os
import time
from pathlib import Path

import pytest

from rossec.authority.home import AuthorityHome
from rossec.host.audit import AuditFile, audit_written
from tests.support.commands import PASSPHRASE, Shell, refused


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


def test_the_audit_is_shown_as_text_and_as_json(shell: Shell) -> None:
    said = shell("audit")
    assert said.code == 0
    assert said.out.splitlines()[0] == "1970-01-01 00:16:40 UTC  one"
    assert "\x1b" not in said.out
    [line] = shell("audit", "--json", "--since", "1500").out.splitlines()
    assert json.loads(line)["text"] == "two\\u001b[0m"


def test_a_changed_line_is_found(shell: Shell) -> None:
    assert "nothing was changed in 2 lines; the last is " in shell("audit", "--verify").err
    path = shell.node("/master") / "audit.log"
    path.write_text(path.read_text().replace("one", "won"))
    refused(shell("audit", "--verify"), "line 1 of the audit was changed")


def test_damaged_lines_hide_no_other_lines(shell: Shell) -> None:
    path = shell.node("/master") / "audit.log"
    one, two = path.read_text().splitlines()
    path.write_text(f"{one}\nx\n{two}\n")
    said = shell("audit")
    assert (said.code, len(said.out.splitlines())) == (0, 2)
    assert f"line 2 of {path} is damaged and not shown" in said.err
    refused(shell("audit", "--verify"), f"line 2 of {path} is damaged", "backup")


def test_a_missing_file_and_omitted_lines_are_reported(shell: Shell) -> None:
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


def test_an_invalid_key_is_refused_and_a_former_key_accepted(shell: Shell) -> None:
    refused(shell("audit", "--verify", "--key", "zz"), "is not a thumbprint", "64 hexadecimal digits")
    said = shell("audit", "--verify", "--key", "00" * 32)
    assert "it is of an older version" in said.err
    empty = shell.root / "empty.log"
    empty.touch()
    assert "in 0 lines" in shell("audit", "--verify", str(empty)).err


@pytest.mark.parametrize("options", [(), ("--verify",)])
def test_what_has_no_end_is_not_read(shell: Shell, options: tuple[str, ...]) -> None:
    os.mkfifo(shell.root / "pipe")
    for path in ("/dev/zero", str(shell.root / "pipe")):
        refused(shell("audit", *options, path), f"{path} is not a regular file", "copy its content")


def test_a_huge_file_of_rubbish_is_given_up(shell: Shell) -> None:
    path = shell.root / "rubbish.log"
    with path.open("wb") as file:
        os.truncate(file.fileno(), 1 << 40)  # sparse, without one line end
    refused(shell("audit", "--verify", str(path)), f"line 1 of {path} is damaged")
    said = shell("audit", str(path))
    refused(said, f"10000 of the first 10000 lines of {path} are damaged", "the right file?")
    assert len(said.err.splitlines()) == 2


def test_many_damaged_lines_hide_no_entry(shell: Shell) -> None:
    path = shell.node("/master") / "audit.log"
    one, two = path.read_text().splitlines()
    path.write_text("\n".join([one, *["x"] * 9999, two, ""]))
    said = shell("audit")
    assert (said.code, len(said.out.splitlines())) == (0, 2)
    assert len(said.err.splitlines()) == 21
    assert f"9979 more lines of {path} are damaged and not shown" in said.err


def test_the_audit_of_the_authoritys_service_is_verified(shell: Shell) -> None:
    home = AuthorityHome.create(shell.root, "home", PASSPHRASE, int(time.time()))
    with audit_written(home.path / "audit.log", home.node().signer()):
        logging.getLogger("rossec.audit").info("signs a grant")
    said = shell("audit", "--ca", "--verify")
    assert said.code == 0
    assert "signs a grant" in said.out
    assert said.err.startswith("rossec: nothing was changed in 2 lines")
