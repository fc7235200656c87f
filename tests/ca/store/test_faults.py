"""Only what is damaged is called damaged: obeying "restore a backup" undoes revocations."""

import errno
import os
import sqlite3
from pathlib import Path
from types import SimpleNamespace

import pytest

from ca.errors import RecordUnusable, StoreError
from ca.store.database import fault

PATH = Path("/authority/ca.db")


def failure(code: int, text: str = "what SQLite said") -> sqlite3.Error:
    error = sqlite3.OperationalError(text)
    error.sqlite_errorcode = code
    return error


@pytest.mark.parametrize(
    ("code", "said", "hint"),
    [
        (sqlite3.SQLITE_FULL, "the disk is full, nothing was changed", "make room"),
        (sqlite3.SQLITE_BUSY, "another command is using it, nothing was", "when that one"),
        (sqlite3.SQLITE_BUSY_SNAPSHOT, "another command is using it", "when that one"),
        (sqlite3.SQLITE_READONLY_DIRECTORY, "it is read-only", "mounted read-only"),
        (sqlite3.SQLITE_IOERR_FSYNC, "the disk reports an error, nothing was changed", "df, dmesg"),
        (sqlite3.SQLITE_MISUSE, "what SQLite said, nothing was changed", "run the command again"),
    ],
)
def test_an_error_without_damage_says_nothing_was_changed(code: int, said: str, hint: str) -> None:
    found = fault(PATH, failure(code))
    assert isinstance(found, RecordUnusable)
    assert str(found).startswith(f"{PATH} cannot be used: {said}")
    assert hint in found.hint
    assert "restore it" not in f"{found} {found.hint}"


@pytest.mark.parametrize("code", [sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB])
def test_damage_is_reported(code: int) -> None:
    found = fault(PATH, failure(code))
    assert isinstance(found, RecordUnusable)
    assert str(found) == f"{PATH} is damaged: what SQLite said"
    assert found.hint == "restore it from a backup, with --list"


def test_an_entry_that_is_refused_is_no_fault_of_the_disk() -> None:
    found = fault(PATH, failure(sqlite3.SQLITE_CONSTRAINT_TRIGGER, "append-only"))
    assert type(found) is StoreError
    assert str(found) == "the record refuses the entry: append-only"


def test_an_error_of_the_interface_has_no_code() -> None:
    found = fault(PATH, sqlite3.ProgrammingError("closed"))
    assert str(found) == f"{PATH} cannot be used: closed, nothing was changed"


@pytest.mark.parametrize("code", [sqlite3.SQLITE_IOERR_SHMSIZE, sqlite3.SQLITE_CANTOPEN])
def test_a_full_disk_shows_in_other_ways_too(code: int, monkeypatch: pytest.MonkeyPatch) -> None:
    full = SimpleNamespace(f_bavail=1, f_frsize=4096)
    monkeypatch.setattr("os.statvfs", lambda _: full)
    assert "the disk is full" in str(fault(PATH, failure(code)))


def test_a_disk_that_does_not_answer_is_not_called_full(monkeypatch: pytest.MonkeyPatch) -> None:
    def gone(_: object) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr("os.statvfs", gone)
    assert "the disk reports an error" in str(fault(PATH, failure(sqlite3.SQLITE_IOERR_READ)))
