"""What is decided by the record and what is recorded are one step, and nobody is in between."""

import os
import sqlite3
import stat
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

from ca.errors import RecordUnusable, StoreError
from ca.store import database as module
from ca.store import database as schema
from ca.store.database import Database, append_entry

NOW = 1_800_000_000


@pytest.fixture
def new(tmp_path: Path) -> Path:
    """Where no record is yet."""
    return tmp_path / "ca.db"


@pytest.fixture
def path(new: Path) -> Path:
    Database.create(new).close()
    return new


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
    monkeypatch.setattr(module, "BUSY_TIMEOUT", 0)
    other = Database.open(path)
    with database.transaction() as db:
        assert noted(database) == []
        with pytest.raises(RecordUnusable, match="another command is using it"), other.transaction():
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
        (sys.executable, "-c", f"{begin}\n{script}"), capture_output=True, text=True, check=False, timeout=300
    )
    return done.stdout + done.stderr


def test_opening_it_once_more_gives_up_no_lock(path: Path, database: Database) -> None:
    """A process that closes any descriptor of a file loses its locks there (fcntl(2))."""
    with database.transaction() as db:
        Database.open(path).close()
        assert "database is locked" in elsewhere(path, "db.execute('BEGIN IMMEDIATE')")
        note(db, "alone")
    assert elsewhere(path, "print(db.execute('SELECT subject FROM log').fetchall())") == ("[('alone',)]\n")


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
def test_a_record_that_was_moved_aside_takes_nothing_in(path: Path, database: Database, there: bool) -> None:
    path.rename(path.with_name("aside.db"))
    if there:
        Database.create(path).close()
    with (
        pytest.raises(StoreError, match="was replaced by another command, nothing") as caught,
        database.transaction(),
    ):
        pytest.fail("written into what was moved aside")
    assert "run the command again" in caught.value.hint


def test_a_record_that_cannot_be_made_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(_: sqlite3.Connection) -> None:
        raise sqlite3.OperationalError("no")

    monkeypatch.setattr(module, "_configure", refuse)
    with pytest.raises(RecordUnusable, match="cannot be used: no, nothing was changed"):
        Database.create(tmp_path / "new.db")


def test_existing_files_are_never_overwritten(new: Path) -> None:
    new.write_bytes(b"precious")
    with pytest.raises(StoreError, match=r"cannot create .*File exists"):
        Database.create(new)
    assert new.read_bytes() == b"precious"
    with pytest.raises(StoreError, match=r"cannot create .*No such file"):
        Database.create(new.parent / "missing" / "ca.db")


def test_nothing_to_open(new: Path) -> None:
    with pytest.raises(StoreError, match="there is no record at"):
        Database.open(new)
    new.mkdir()
    with pytest.raises(StoreError, match="there is no record at"):
        Database.open(new)


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o622])
def test_a_record_others_can_reach(new: Path, mode: int) -> None:
    Database.create(new).close()
    new.chmod(mode)
    with pytest.raises(StoreError, match="can be read or written by others") as caught:
        Database.open(new)
    assert "chmod 600" in caught.value.hint


def test_a_foreign_database_is_refused_and_left_as_it_is(new: Path) -> None:
    foreign = sqlite3.connect(new)
    foreign.execute("CREATE TABLE precious (id INTEGER)")
    foreign.commit()
    foreign.close()
    new.chmod(0o600)
    before = new.read_bytes()
    with pytest.raises(StoreError, match="is not a record of rossec"):
        Database.open(new)
    assert new.read_bytes() == before


def test_a_record_from_the_future(new: Path) -> None:
    made = Database.create(new)
    made.connection.execute(f"PRAGMA user_version = {schema.VERSION + 1}")
    made.close()
    with pytest.raises(StoreError, match="written by a newer version of rossec") as caught:
        Database.open(new)
    assert "use that version" in caught.value.hint
    assert "rossec ca restore FILE --list FILE" in caught.value.hint


@pytest.mark.parametrize("data", [b"", b"garbage" * 1000])
def test_a_file_that_is_no_database_is_refused(new: Path, data: bytes) -> None:
    new.write_bytes(data)
    new.chmod(0o600)
    with pytest.raises(StoreError, match=r"is damaged|is not a record") as caught:
        Database.open(new)
    assert "restore it" in caught.value.hint


def test_a_file_that_goes_between_look_and_open(new: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """SQLite is told never to create a file: a vanished record is not an empty one."""
    regular = SimpleNamespace(st_mode=stat.S_IFREG | 0o600)
    monkeypatch.setattr(Path, "stat", lambda *_, **__: regular)
    with pytest.raises(StoreError, match="cannot be used: unable to open database file"):
        Database.open(new)
    assert not os.path.lexists(new)


def test_a_damaged_or_closed_record_gives_nothing(path: Path) -> None:
    made = Database.open(path)
    with made.transaction() as db:
        for number in range(500):
            note(db, f"{number}" * 200)
    made.close()
    data = bytearray(path.read_bytes())
    data[64 * 4096 :] = b"\xff" * (len(data) - 64 * 4096)  # after the tables' first pages
    path.write_bytes(data)
    damaged = Database.open(path)
    for read in (damaged.check, lambda: noted(damaged)):
        with pytest.raises(StoreError, match="is damaged: "):
            read()
    damaged.close()
    for use in (damaged.check, damaged.snapshot, lambda: noted(damaged), lambda: fail(damaged, "")):
        with pytest.raises(RecordUnusable, match="closed"):
            use()


def test_a_snapshot_is_a_whole_record(path: Path, database: Database) -> None:
    with database.transaction() as db:
        note(db, "kept")
    copy = path.with_name("copy.db")
    copy.touch(0o600)
    copy.write_bytes(database.snapshot())
    copied = Database.open(copy)
    assert noted(copied) == ["kept"]
    copied.close()
