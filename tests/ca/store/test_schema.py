import os
import sqlite3
import subprocess
import sys
from collections.abc import Iterable, Iterator
from contextlib import closing
from itertools import permutations
from pathlib import Path

import pytest

from ca.errors import LogDamaged, StoreError
from ca.store import schema
from ca.store.lifecycle import TRANSITIONS, RequestState
from ca.store.record import Store
from tests.support import oldstore
from tests.support.pki import new_signer


@pytest.fixture
def old(tmp_path: Path) -> Path:
    path = tmp_path / "old.db"
    oldstore.write_version_1(path)
    return path


@pytest.fixture
def new(tmp_path: Path) -> Iterator[sqlite3.Connection]:
    Store.create(tmp_path / "new.db").close()
    with closing(sqlite3.connect(tmp_path / "new.db", isolation_level=None)) as db:
        yield db


def shape(db: sqlite3.Connection) -> list[tuple[str, str]]:
    return db.execute(
        "SELECT name, sql FROM sqlite_master WHERE sql IS NOT NULL ORDER BY name"
    ).fetchall()


def test_an_old_record_is_brought_up_without_loss(old: Path) -> None:
    with closing(Store.open(old)) as store:
        count = len(oldstore.KEYS)
        assert [row.thumbprint for row in store.identities.all()] == oldstore.KEYS
        assert [row.id for row in store.grants()] == [key[:16] for key in oldstore.KEYS]
        assert store.revoked_entries() == {key[:16] for key in oldstore.KEYS}
        assert store.next_number() == (1, count + 1)
        entries = store.log.entries()
        assert [entry.what for entry in entries[:4]] == [
            "certificate",
            "grant",
            "revocation",
            "list",
        ]
        assert [entry.number for entry in entries] == list(range(4 * count + 1))
        assert entries[0][1:5] == (oldstore.NOW, "certificate", "/node0", oldstore.KEYS[0].hex())
        assert entries[-1].what == "migrated"
        store.log.audit(new_signer().public_key)
        store.revoke(b"n" * 32, "after", oldstore.NOW)
        store.log.audit(new_signer().public_key)


def test_both_ways_lead_to_the_same_tables(old: Path, new: sqlite3.Connection) -> None:
    Store.open(old).close()
    with closing(sqlite3.connect(old)) as db:
        assert shape(db) == shape(new)


def test_a_migrated_record_is_not_migrated_again(old: Path) -> None:
    Store.open(old).close()
    with closing(sqlite3.connect(old, isolation_level=None)) as db:
        before = db.execute("SELECT count(*) FROM log").fetchone()
        schema.migrate(db)  # a second command that waited for the first
        assert db.execute("SELECT count(*) FROM log").fetchone() == before
    Store.open(old).close()


def test_requests_for_grants_keep_their_rows(old: Path) -> None:
    """In version 1 the inbox had a table with the name that requests for identities have now."""
    with closing(sqlite3.connect(old)) as db, db:
        db.execute("CREATE TABLE request (id BLOB PRIMARY KEY, data BLOB NOT NULL) STRICT")
        db.execute("INSERT INTO request VALUES (x'01', x'02')")
    with closing(Store.open(old)) as store:
        assert store.requests.all() == []
    with closing(sqlite3.connect(old)) as db:
        assert db.execute("SELECT * FROM grant_request").fetchall() == [(b"\x01", b"\x02")]


def test_an_empty_old_record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(oldstore, "KEYS", [])
    oldstore.write_version_1(tmp_path / "old.db")
    with closing(Store.open(tmp_path / "old.db")) as store:
        assert [entry.at for entry in store.log.entries()] == [0]


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ("INSERT INTO log (at, what, subject, detail) VALUES (0, 'grant', '', '')", "grant"),
        ("INSERT INTO log (at, what, subject, detail) VALUES (0, 'party', '', '')", "party"),
    ],
)
def test_an_old_log_that_does_not_fit_is_not_brought_up(old: Path, change: str, what: str) -> None:
    with closing(sqlite3.connect(old, isolation_level=None)) as db:
        db.execute(change)
        before = shape(db)
    with pytest.raises(LogDamaged, match=f"line 20 of the log is about a {what} that is not"):
        Store.open(old)
    with closing(sqlite3.connect(old)) as db:
        assert shape(db) == before
        assert schema.version(db) == 1


def insert(db: sqlite3.Connection, state: str) -> None:
    db.execute(
        "INSERT INTO csr VALUES (x'01', '/a', x'02', x'03', '', 0, ?, '', 0, 0, 0)", (state,)
    )


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
    schema.create(db)
    return db


def test_a_record_of_ours_is_ours(record: sqlite3.Connection) -> None:
    schema.check_no_foreign_objects(record)
    record.execute("CREATE TABLE beside (x TEXT)")
    record.execute(
        "CREATE TRIGGER IF NOT EXISTS other_name BEFORE DELETE ON beside\n"
        "BEGIN SELECT RAISE(ABORT, 'the record is append-only'); END;"
    )
    schema.check_no_foreign_objects(record)


def moves(record: sqlite3.Connection, ways: Iterable[str]) -> None:
    """Let the record's requests go these ways."""
    listed = ", ".join(f"'{way}'" for way in ways)
    record.executescript(
        "DROP TRIGGER csr_moves;" + schema._REQUEST_TRANSITIONS.format(allowed=listed)
    )


WAYS = [f"{old}>{new}" for old, following in TRANSITIONS.items() for new in following]


@pytest.mark.parametrize("ways", list(permutations(WAYS)))
def test_the_ways_of_a_request_are_a_set(record: sqlite3.Connection, ways: tuple[str, ...]) -> None:
    """Older versions wrote them in the order of a frozenset: any, and another in each process."""
    moves(record, ways)
    schema.check_no_foreign_objects(record)


@pytest.mark.parametrize("ways", [WAYS[1:], [*WAYS, "denied>issued"], [*WAYS[1:], WAYS[1]]])
def test_a_set_of_other_ways_is_not_ours(record: sqlite3.Connection, ways: list[str]) -> None:
    moves(record, ways)
    with pytest.raises(StoreError, match="a trigger that is not rossec's: 'csr_moves'"):
        schema.check_no_foreign_objects(record)


def test_every_process_makes_the_same_record() -> None:
    script = (
        "import sqlite3; from ca.store import schema; db = sqlite3.connect(':memory:');"
        "schema.create(db); print('\\n'.join(db.iterdump()))"
    )
    made = {
        subprocess.run(
            (sys.executable, "-c", script), env={**os.environ, "PYTHONHASHSEED": seed},
            capture_output=True, check=True, timeout=300,
        ).stdout
        for seed in "12345678"
    }  # fmt: skip
    assert len(made) == 1


@pytest.mark.parametrize(
    ("script", "said"),
    [
        ("CREATE TRIGGER x AFTER INSERT ON log BEGIN SELECT 1; END", "a trigger that is not"),
        ("CREATE TABLE y (a); CREATE TRIGGER x AFTER INSERT ON y BEGIN SELECT 1; END", "a trigger"),
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
        schema.check_no_foreign_objects(record)
    assert "a backup of your own" in caught.value.hint


def test_tables_of_another_form_hold_nothing_that_counts(tmp_path: Path) -> None:
    """Somebody else's file, in which a number may be a text, and a name nothing at all."""
    path = tmp_path / "ca.db"
    Store.create(path).close()
    with closing(sqlite3.connect(path, isolation_level=None)) as db:
        db.execute("DROP TABLE head")
        db.execute("CREATE TABLE head (data, at)")
        db.execute("INSERT INTO head VALUES (-1, 'never')")
    with pytest.raises(
        StoreError, match="the table head of the record differs from rossec's schema"
    ):
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
