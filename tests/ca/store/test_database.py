"""What is decided by the record and what is recorded are one step, and nobody is in between."""

import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from ca.errors import RecordUnusable, StoreError
from ca.store import database as module
from ca.store.database import Database
from ca.store.schema import append_entry

NOW = 1_800_000_000


@pytest.fixture
def path(tmp_path: Path) -> Path:
    Database.create(tmp_path / "ca.db").close()
    return tmp_path / "ca.db"


@pytest.fixture
def database(path: Path) -> Iterator[Database]:
    opened = Database.open(path)
    yield opened
    opened.close()


def note(db: sqlite3.Connection, text: str) -> None:
    append_entry(db, NOW, "noted", text, "", b"")


def fail(database: Database, text: str) -> None:
    """Write, and fail before it is done."""
    with database.transaction() as db:
        note(db, text)
        raise ValueError(text)


def noted(database: Database) -> list[str]:
    return [subject for (subject,) in database.rows("SELECT subject FROM log ORDER BY number")]


def test_no_command_writes_between_a_decision_and_its_record(
    path: Path, database: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "_BUSY_TIMEOUT", 0)
    other = Database.open(path)
    with database.transaction() as db:
        assert noted(database) == []
        with (
            pytest.raises(RecordUnusable, match="another command is using it"),
            other.transaction(),
        ):
            pytest.fail("two are at work")
        note(db, "decided")
    with other.transaction() as db:
        note(db, "then the other")
    assert noted(database) == ["decided", "then the other"]
    other.close()


def elsewhere(path: Path, script: str) -> str:
    """What another process prints that does this with the record as `db`."""
    begin = f"import sqlite3; db = sqlite3.connect({str(path)!r}, timeout=0, isolation_level=None)"
    done = subprocess.run(
        (sys.executable, "-c", f"{begin}\n{script}"),
        capture_output=True, text=True, check=False, timeout=300,
    )  # fmt: skip
    return done.stdout + done.stderr


def test_opening_it_once_more_gives_up_no_lock(path: Path, database: Database) -> None:
    """A process that closes any descriptor of a file loses its locks there (fcntl(2))."""
    with database.transaction() as db:
        Database.open(path).close()
        assert "database is locked" in elsewhere(path, "db.execute('BEGIN IMMEDIATE')")
        note(db, "alone")
    assert elsewhere(path, "print(db.execute('SELECT subject FROM log').fetchall())") == (
        "[('alone',)]\n"
    )


def test_another_process_that_ends_takes_nothing_away(path: Path, database: Database) -> None:
    """Whoever closes a record last removes its journal: it must know that it is not the last."""
    Database.open(path).close()
    assert noted(database) == []
    for number in range(3):
        insert = f"db.execute('INSERT INTO head VALUES (?, 0)', (b\"{number}\",)); db.close()"
        assert elsewhere(path, insert) == ""
        Database.open(path).close()
        assert len(database.rows("SELECT * FROM head")) == number + 1
    with database.transaction() as db:
        note(db, "after them")
    database.check()
    assert elsewhere(path, "print(len(db.execute('SELECT * FROM log').fetchall()))") == "1\n"


def test_a_part_that_fails_is_undone_alone(database: Database) -> None:
    with database.transaction() as db:
        note(db, "first")
        with pytest.raises(ValueError, match="undone"):
            fail(database, "undone")
        with database.transaction():
            note(db, "second")
    assert noted(database) == ["first", "second"]


def test_a_whole_that_fails_leaves_no_part(database: Database) -> None:
    def whole() -> None:
        with database.transaction():
            with database.transaction() as db:
                note(db, "part")
            fail(database, "another part")

    with pytest.raises(ValueError, match="another part"):
        whole()
    assert noted(database) == []


def test_a_reader_sees_one_moment(path: Path, database: Database) -> None:
    other = Database.open(path)
    with database.read_transaction():
        assert noted(database) == []
        with other.transaction() as db:
            note(db, "meanwhile")
        with database.read_transaction():
            assert noted(database) == []
    assert noted(database) == ["meanwhile"]
    with database.transaction() as db, database.read_transaction():
        note(db, "own")
        assert noted(database) == ["meanwhile", "own"]
    other.close()


@pytest.mark.parametrize("there", [True, False])
def test_a_record_that_was_moved_aside_takes_nothing_in(
    path: Path, database: Database, there: bool
) -> None:
    path.rename(path.with_name("aside.db"))
    if there:
        Database.create(path).close()
    with (
        pytest.raises(StoreError, match="was replaced by another command, nothing") as caught,
        database.transaction(),
    ):
        pytest.fail("written into what was moved aside")
    assert "run the command again" in caught.value.hint


def test_a_record_that_cannot_be_made_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(_: sqlite3.Connection) -> None:
        raise sqlite3.OperationalError("no")

    monkeypatch.setattr(module, "_configure", refuse)
    with pytest.raises(RecordUnusable, match="cannot be used: no, nothing was changed"):
        Database.create(tmp_path / "new.db")
