import os
import sqlite3
import subprocess
import sys
from collections.abc import Iterable, Iterator
from contextlib import closing
from pathlib import Path

import pytest

from ca.errors import StoreError
from ca.store import database
from ca.store.record import Store
from ca.store.values import TRANSITIONS, RequestState
from tests.support.pki import new_signer


@pytest.fixture
def new(tmp_path: Path) -> Iterator[sqlite3.Connection]:
    Store.create(tmp_path / "new.db").close()
    with closing(sqlite3.connect(tmp_path / "new.db", isolation_level=None)) as db:
        yield db


def insert(db: sqlite3.Connection, state: str) -> None:
    db.execute("INSERT INTO csr VALUES (x'01', '/a', x'02', x'03', '', 0, ?, '', 0, 0, 0)", (state,))


@pytest.mark.parametrize("old_state", sorted(RequestState))
@pytest.mark.parametrize("new_state", sorted(RequestState))
def test_the_record_knows_the_ways_of_a_request(
    new: sqlite3.Connection, old_state: RequestState, new_state: RequestState
) -> None:
    insert(new, "pending")
    if old_state is RequestState.ISSUED:
        new.execute("UPDATE csr SET state = 'approved'")
    if old_state is not RequestState.PENDING:
        new.execute("UPDATE csr SET state = ?", (old_state,))
    move = ("UPDATE csr SET state = ?", (new_state,))
    if new_state in TRANSITIONS[old_state]:
        new.execute(*move)
    else:
        with pytest.raises(sqlite3.IntegrityError, match="a request does not go this way"):
            new.execute(*move)


def test_a_request_begins_pending_and_does_not_change(new: sqlite3.Connection) -> None:
    with pytest.raises(sqlite3.IntegrityError, match="a request begins pending"):
        insert(new, "approved")
    insert(new, "pending")
    with pytest.raises(sqlite3.IntegrityError, match="a request does not change"):
        new.execute("UPDATE csr SET name = '/b'")
    with pytest.raises(sqlite3.IntegrityError, match="a request does not go this way"):
        new.execute("UPDATE csr SET replaces = 1")


@pytest.fixture
def record() -> sqlite3.Connection:
    db = sqlite3.connect(":memory:", isolation_level=None)
    database.create(db)
    return db


def test_a_record_of_ours_is_ours(record: sqlite3.Connection) -> None:
    database.check_no_foreign_objects(record)


def moves(record: sqlite3.Connection, ways: Iterable[str]) -> None:
    """Let the record's requests go these ways."""
    listed = ", ".join(f"'{way}'" for way in ways)
    record.executescript("DROP TRIGGER csr_moves;" + database._REQUEST_TRANSITIONS.format(allowed=listed))


WAYS = [f"{old}>{new}" for old, following in TRANSITIONS.items() for new in following]


@pytest.mark.parametrize("ways", [WAYS[1:], [*WAYS, "denied>issued"], [*WAYS[1:], WAYS[1]]])
def test_a_set_of_other_ways_is_not_ours(record: sqlite3.Connection, ways: list[str]) -> None:
    moves(record, ways)
    with pytest.raises(StoreError, match="a trigger that is not rossec's: 'csr_moves'"):
        database.check_no_foreign_objects(record)


def test_every_process_makes_the_same_record() -> None:
    script = (
        "import sqlite3; from ca.store import database; db = sqlite3.connect(':memory:');"
        "database.create(db); print('\\n'.join(db.iterdump()))"
    )
    made = {
        subprocess.run(
            (sys.executable, "-c", script),
            env={**os.environ, "PYTHONHASHSEED": seed},
            capture_output=True,
            check=True,
            timeout=300,
        ).stdout
        for seed in "12345678"
    }
    assert len(made) == 1


@pytest.mark.parametrize(
    ("script", "said"),
    [
        ("CREATE TRIGGER x AFTER INSERT ON log BEGIN SELECT 1; END", "a trigger that is not"),
        ("CREATE TABLE x (a)", "a table that is not rossec's: 'x'"),
        ("CREATE VIEW x AS SELECT 1", "a view that is not rossec's: 'x'"),
        ("CREATE VIRTUAL TABLE x USING fts5(a)", "a table that is not rossec's: 'x'"),
        ("CREATE INDEX x ON log (at)", "a index that is not rossec's: 'x'"),
        ("DROP TRIGGER log_no_DELETE", "lacks log_no_DELETE"),
        ("DROP TABLE answer; CREATE TABLE answer (request)", "'answer'"),
    ],
)
def test_a_record_of_somebody_else(record: sqlite3.Connection, script: str, said: str) -> None:
    record.executescript(script)
    with pytest.raises(StoreError, match=said) as caught:
        database.check_no_foreign_objects(record)
    assert "a backup of your own" in caught.value.hint


def test_tables_of_another_form_hold_nothing_that_counts(tmp_path: Path) -> None:
    """Somebody else's file, in which a number may be a text, and a name nothing at all."""
    path = tmp_path / "ca.db"
    Store.create(path).close()
    with closing(sqlite3.connect(path, isolation_level=None)) as db:
        db.execute("DROP TABLE head")
        db.execute("CREATE TABLE head (data, at)")
        db.execute("INSERT INTO head VALUES (-1, 'never')")
    with pytest.raises(StoreError, match="the table head of the record differs from rossec's schema"):
        Store.open(path)


def test_an_unknown_request_state_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "ca.db"
    Store.create(path).close()
    with closing(sqlite3.connect(path, isolation_level=None)) as db:
        db.execute("DROP TRIGGER csr_begins")
        row = (b"d", "/a", b"t", b"der", "file", 0, "begun", "", 0, 0, 0)
        db.execute(f"INSERT INTO csr VALUES ({','.join('?' * len(row))})", row)
    with closing(Store.open(path)) as store:
        for look in (store.requests.all, lambda: store.log.audit(new_signer().public_key)):
            with pytest.raises(StoreError, match="an unknown state: 'begun'"):
                look()


def test_a_record_of_a_development_version_is_refused_and_not_changed(tmp_path: Path) -> None:
    path = tmp_path / "ca.db"
    Store.create(path).close()
    with closing(sqlite3.connect(path, isolation_level=None)) as db:
        db.execute("PRAGMA user_version = 5")
    before = path.read_bytes()
    with pytest.raises(StoreError, match="is not a record of rossec"):
        Store.open(path)
    assert path.read_bytes() == before
