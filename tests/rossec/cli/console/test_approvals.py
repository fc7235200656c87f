"""`rossec console approvals`: what was approved, and that a changed record is found."""

import json
import sqlite3
from contextlib import closing
from pathlib import Path

from tests.support.commands import Shell, refused
from tests.support.consoleacts import Acts


def approved(shell: Shell) -> Acts:
    acts = Acts(shell.root)
    acts.enroll("/lamp")
    acts.lock()
    acts.approve("invitation", "/lamps/*", 3, 3600, False)
    acts.enroll("/late")
    return acts


def test_every_approval_is_shown_with_what_came_of_it(empty: Shell) -> None:
    assert "there is no authority" in empty("console", "approvals").err
    acts = approved(empty)
    lines = empty("console", "approvals").out.splitlines()
    assert [line.partition("Ann's phone  ")[2] for line in lines][::2] == [
        "identity of /lamp: done (/lamp is enrolled)",
        "identity of /late: waiting",
    ]
    assert "join code for 3 of /lamps/*: done (join code " in lines[1]
    found = json.loads(empty("console", "approvals", "--json").out)
    assert [(each["kind"], each["state"]) for each in found] == [
        ("enroll", "done"),
        ("invitation", "done"),
        ("enroll", "waiting"),
    ]
    assert found[0]["phone"] == "Ann's phone"
    assert found[0]["statement"] in acts.audit[1]


def test_nothing_approved_is_said(empty: Shell) -> None:
    Acts(empty.root)
    assert empty("console", "approvals").out == "nothing was approved at the console yet\n"


def test_signatures_are_recomputed(empty: Shell) -> None:
    approved(empty)
    assert empty("console", "approvals", "--verify").out.splitlines()[-1] == (
        "3 approvals, each signed by its phone"
    )
    found = json.loads(empty("console", "approvals", "--verify", "--json").out)
    assert all(each["verified"] for each in found)
    _forge(empty.root / "ca" / "ca.db")
    refused(empty("console", "approvals", "--verify"), "the approval of log entry")


def _forge(path: Path) -> None:
    with closing(sqlite3.connect(path)) as db:
        db.execute("DROP TRIGGER approval_no_UPDATE")
        db.execute("UPDATE approval SET signature = x'3006020101020101'")
        db.commit()
