import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from ca.errors import LogDamaged, StoreError
from ca.store import database
from ca.store.record import Store
from tests.support import approving, oldstore
from tests.support.pki import new_signer
from tests.support.things import LAMP, add_thing
from tests.vectors.make_things import HOME


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
    return db.execute("SELECT name, sql FROM sqlite_master WHERE sql IS NOT NULL ORDER BY name").fetchall()


def test_an_old_record_is_brought_up_without_loss(old: Path) -> None:
    with closing(Store.open(old)) as store:
        count = len(oldstore.KEYS)
        assert [row.thumbprint for row in store.identities.all()] == oldstore.KEYS
        assert [row.id for row in store.grants()] == [key[:16] for key in oldstore.KEYS]
        assert store.revoked_entries() == {key[:16] for key in oldstore.KEYS}
        assert store.next_number() == (1, count + 1)
        entries = store.log.entries()
        assert [entry.what for entry in entries[:4]] == ["certificate", "grant", "revocation", "list"]
        assert [entry.number for entry in entries] == list(range(4 * count + 5))
        assert entries[0][1:5] == (oldstore.NOW, "certificate", "/node0", oldstore.KEYS[0].hex())
        assert [(e.what, e.detail) for e in entries[-5:]] == [
            ("migrated", "1 to 2"),
            ("migrated", "2 to 3"),
            ("migrated", "3 to 4"),
            ("migrated", "4 to 5"),
            ("migrated", "5 to 6"),
        ]
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
        database.migrate(db)  # a second command that waited for the first
        assert db.execute("SELECT count(*) FROM log").fetchone() == before
    Store.open(old).close()


REQUEST_TABLES = (
    """CREATE TABLE IF NOT EXISTS {} (
        id BLOB PRIMARY KEY, name TEXT NOT NULL, data BLOB NOT NULL, at INTEGER NOT NULL
    ) STRICT""",
    """CREATE TABLE IF NOT EXISTS decision (
        request BLOB NOT NULL, right INTEGER NOT NULL, pattern TEXT NOT NULL,
        answer TEXT NOT NULL, reason TEXT NOT NULL, at INTEGER NOT NULL,
        PRIMARY KEY (request, right, pattern)
    ) STRICT""",
    """CREATE TRIGGER decision_no_DELETE BEFORE DELETE ON decision
    BEGIN SELECT RAISE(ABORT, 'the record is append-only'); END""",
    "INSERT INTO {} VALUES (x'02', '/b', x'0b', 2), (x'01', '/a', x'0a', 3)",
    "INSERT INTO decision VALUES (x'01', 1, '/t', 'granted', 'policy', 4)",
)


def write_grant_requests(path: Path, table: str) -> None:
    """The tables that grant requests had on their own, below `table` in version 1."""
    with closing(sqlite3.connect(path)) as db, db:
        for statement in REQUEST_TABLES:
            db.execute(statement.format(table))


def test_grant_requests_of_version_1_enter_the_log(old: Path) -> None:
    """In version 1 they had the name that requests for identities have now."""
    write_grant_requests(old, "request")
    check_grant_requests(old)


def test_grant_requests_of_version_2_enter_the_log(old: Path) -> None:
    with closing(sqlite3.connect(old, isolation_level=None)) as db:
        to_version_2(db)
    write_grant_requests(old, "grant_request")
    check_grant_requests(old)


def to_version_2(db: sqlite3.Connection) -> None:
    """As the previous release has migrated it: without what version 3 adds."""
    database.migrate(db)
    later = (*database.VERSION_3, *database.VERSION_4, *database.VERSION_5, *database.VERSION_6)
    for table in database.append_only(later):
        db.execute(f"DROP TABLE {table}")
    db.execute("DROP TRIGGER log_no_DELETE")
    db.execute("DELETE FROM log WHERE detail IN ('2 to 3', '3 to 4', '4 to 5', '5 to 6')")
    for statement in database.append_only_triggers(("log",)):
        db.execute(statement.replace("CREATE TRIGGER", "CREATE TRIGGER IF NOT EXISTS"))
    db.execute("PRAGMA user_version = 2")


def check_grant_requests(path: Path) -> None:
    with closing(Store.open(path)) as store:
        assert store.requests.all() == []
        store.log.audit(new_signer().public_key)
        store.database.check()
        logged = [(e.what, e.subject, e.detail, e.at) for e in store.log.entries()[-7:]]
    assert logged == [
        ("grant request", "/b", "02", 2),
        ("grant request", "/a", "01", 3),
        ("decision", "/a", "granted /t", 4),
        ("migrated", "record", "2 to 3", logged[-1][3]),
        ("migrated", "record", "3 to 4", logged[-1][3]),
        ("migrated", "record", "4 to 5", logged[-1][3]),
        ("migrated", "record", "5 to 6", logged[-1][3]),
    ]
    with closing(sqlite3.connect(path)) as db:
        rows = db.execute("SELECT id FROM grant_request ORDER BY rowid").fetchall()
        assert rows == [(b"\x02",), (b"\x01",)]
        with pytest.raises(sqlite3.IntegrityError, match="append-only"):
            db.execute("DELETE FROM grant_request")


def test_an_older_record_has_no_passkeys_and_can_have_some(old: Path) -> None:
    with closing(Store.open(old)) as store:
        assert (store.passkeys.all(), store.approvals.all()) == ([], [])
        store.passkeys.add(approving.PASSKEY)
        store.approvals.add(approving.approve(store))
        store.log.audit(new_signer().public_key)
        store.database.check()


def test_an_older_record_has_no_things_and_can_have_some(old: Path) -> None:
    with closing(Store.open(old)) as store:
        assert store.things.all() == []
        add_thing(store, LAMP)
        store.log.audit(HOME.public_key)
        store.database.check()


def test_grants_of_older_records_count_as_made_by_hand(old: Path) -> None:
    with closing(Store.open(old)) as store:
        assert store.grants()
        assert store.policy_grants() == {}


def test_a_migration_that_fails_changes_nothing(old: Path) -> None:
    with closing(sqlite3.connect(old, isolation_level=None)) as db:
        db.execute("CREATE TABLE policy_grant (id)")
    with pytest.raises(StoreError, match="policy_grant"):
        Store.open(old)
    with closing(sqlite3.connect(old)) as db:
        assert database.version(db) == 1


def test_an_empty_old_record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(oldstore, "KEYS", [])
    oldstore.write_version_1(tmp_path / "old.db")
    with closing(Store.open(tmp_path / "old.db")) as store:
        assert [entry.at for entry in store.log.entries()] == [0, 0, 0, 0, 0]


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
        assert database.version(db) == 1
