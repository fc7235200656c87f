"""The tables and triggers of the authority's record, and the migration from older versions.

Certificates, grants, revocations, lists, heads and the log are append-only: triggers refuse every
change. A request follows `ca.store.lifecycle.TRANSITIONS` and is deleted at its end; triggers made
from that table refuse every other transition. All functions run inside the caller's transaction.
"""

import re
import sqlite3
from collections.abc import Iterator
from typing import Final

from ca.errors import LogDamaged, StoreError
from ca.store.lifecycle import TRANSITIONS, RequestState
from ca.store.log_entries import LogEntry, digest_of, extend_peaks

APPLICATION_ID: Final = 0x524F5343  # "ROSC"
VERSION: Final = 2
_RESTORE_HINT: Final = "restore a backup of your own, and find out who made this one"
APPEND_ONLY: Final = ("certificate", "grant_", "revocation", "list", "head", "log")
_TABLES: Final = (*APPEND_ONLY, "answer", "csr")
# For each kind of log entry: the table, and the columns in the order of the digest.
LOGGED_TABLES: Final = {
    "certificate": ("certificate", "serial, name, thumbprint, der, not_before, not_after"),
    "grant": ("grant_", "id, name, data, not_before, expires"),
    "revocation": ("revocation", "entry, reason"),
    "list": ("list", "epoch, seq, data"),
}

_VERSION_1: Final = (  # unchanged since version 1
    """CREATE TABLE certificate (
        serial BLOB PRIMARY KEY, name TEXT NOT NULL, thumbprint BLOB NOT NULL, der BLOB NOT NULL,
        not_before INTEGER NOT NULL, not_after INTEGER NOT NULL, at INTEGER NOT NULL
    ) STRICT""",
    "CREATE INDEX certificate_name ON certificate (name, not_after)",
    """CREATE TABLE grant_ (
        id BLOB PRIMARY KEY, name TEXT NOT NULL, data BLOB NOT NULL,
        not_before INTEGER NOT NULL, expires INTEGER NOT NULL, at INTEGER NOT NULL
    ) STRICT""",
    """CREATE TABLE revocation (entry BLOB PRIMARY KEY, reason TEXT NOT NULL, at INTEGER NOT NULL)
        STRICT""",
    """CREATE TABLE list (
        epoch INTEGER NOT NULL, seq INTEGER NOT NULL, data BLOB NOT NULL, at INTEGER NOT NULL,
        PRIMARY KEY (epoch, seq)
    ) STRICT""",
)
_VERSION_2: Final = (
    """CREATE TABLE log (
        number INTEGER PRIMARY KEY, at INTEGER NOT NULL, what TEXT NOT NULL, subject TEXT NOT NULL,
        detail TEXT NOT NULL, digest BLOB NOT NULL, peaks BLOB NOT NULL
    ) STRICT""",
    "CREATE TABLE head (data BLOB PRIMARY KEY, at INTEGER NOT NULL) STRICT",
    """CREATE TABLE csr (
        digest BLOB PRIMARY KEY, name TEXT NOT NULL, thumbprint BLOB NOT NULL, der BLOB NOT NULL,
        source TEXT NOT NULL, arrived INTEGER NOT NULL,
        state TEXT NOT NULL, reason TEXT NOT NULL, changed INTEGER NOT NULL,
        replaces INTEGER NOT NULL, wildcard INTEGER NOT NULL
    ) STRICT""",
    # One request, one certificate: also when two commands run at once, or one was killed.
    """CREATE TABLE answer (
        request BLOB PRIMARY KEY, serial BLOB NOT NULL UNIQUE, at INTEGER NOT NULL
    ) STRICT""",
)
_NO_CHANGE: Final = """
CREATE TRIGGER {table}_no_{verb} BEFORE {verb} ON {table}
BEGIN SELECT RAISE(ABORT, 'the record is append-only'); END;
"""
_NEW_REQUEST: Final = f"""
CREATE TRIGGER csr_begins BEFORE INSERT ON csr WHEN NEW.state <> '{RequestState.PENDING}'
BEGIN SELECT RAISE(ABORT, 'a request begins pending'); END;
"""
_REQUEST_IMMUTABLE: Final = """
CREATE TRIGGER csr_fixed
BEFORE UPDATE OF digest, name, thumbprint, der, source, arrived ON csr
BEGIN SELECT RAISE(ABORT, 'a request does not change'); END;
"""
_REQUEST_TRANSITIONS: Final = """
CREATE TRIGGER csr_moves BEFORE UPDATE OF state, reason, changed, replaces, wildcard ON csr
WHEN (OLD.state || '>' || NEW.state) NOT IN ({allowed})
BEGIN SELECT RAISE(ABORT, 'a request does not go this way'); END;
"""
_SET: Final = re.compile(r"in \(([^()]*)\)")


def create(db: sqlite3.Connection) -> None:
    """Create the tables of a new record."""
    for statement in (*_VERSION_1, *_VERSION_2, *_triggers((*APPEND_ONLY, "answer"))):
        db.execute(statement)
    db.execute(f"PRAGMA application_id = {APPLICATION_ID}")
    db.execute(f"PRAGMA user_version = {VERSION}")


def check_no_foreign_objects(db: sqlite3.Connection) -> None:
    """Return if this file has no triggers and views but those created here.

    A trigger could drop an inserted row, a view or a virtual table could replace a table. Other
    plain tables are allowed, with triggers that make them append-only in this module's form: the
    grant request store has some.

    Raises:
        StoreError: names the first object that is foreign, missing or changed.
    """
    expected_db = sqlite3.connect(":memory:")
    create(expected_db)
    expected, found = _objects(expected_db), _objects(db)
    expected_db.close()
    for name, created in found.items():
        if name in expected and expected[name] == created:
            continue
        if name in expected or not _is_extra_table(*created):
            raise StoreError(
                f"the record holds a {created[0]} that is not rossec's: {name!a}", _RESTORE_HINT
            )
    if missing := expected.keys() - found.keys():
        raise StoreError(f"the record lacks {min(missing)}", _RESTORE_HINT)


def _is_extra_table(kind: str, table: str, text: str) -> bool:
    """Whether it is another plain table, or a trigger that makes it append-only."""
    if kind == "trigger":
        body = text.split()[3:]  # a renamed table left the trigger its old name
        return table not in _TABLES and body in [
            _canonical(_NO_CHANGE.format(table=table, verb=verb)).split()[3:]
            for verb in ("UPDATE", "DELETE")
        ]
    return kind == "table" and text.startswith("create table ")


def _objects(db: sqlite3.Connection) -> dict[str, tuple[str, str, str]]:
    """The objects in a file: kind, table and SQL by name, without SQLite's own indexes."""
    rows = db.execute("SELECT name, type, tbl_name, sql FROM sqlite_master WHERE sql IS NOT NULL")
    return {name: (kind, table, _canonical(text)) for name, kind, table, text in rows}


def _canonical(text: str) -> str:
    """A statement in canonical form: whitespace, case, quotes and IF NOT EXISTS do not matter.

    Nor does the order of a set: until 0.1.0 that of `csr_moves` differed in each process.
    """
    words = text.lower().replace('"', "").replace("if not exists ", "").replace(";", " ").split()
    return _SET.sub(lambda found: str(sorted(found[1].split(", "))), " ".join(words))


def version(db: sqlite3.Connection) -> int:
    """The schema version of this file; 0 if it is not a record."""
    (number,) = db.execute("PRAGMA user_version").fetchone()
    return int(number)


def check(db: sqlite3.Connection) -> None:
    """Return if the tables are those created here, with strict types.

    Raises:
        StoreError: one is missing or different.
    """
    rows = db.execute("SELECT name, sql FROM sqlite_master WHERE type = 'table'")
    found = {name: _normal(sql) for name, sql in rows}
    for statement in (*_VERSION_1, *_VERSION_2):
        kind, name = statement.split()[1:3]
        if kind == "TABLE" and found.get(name) != _normal(statement):
            raise StoreError(
                f"the table {name} of the record differs from rossec's schema",
                "restore it from a backup of your own, and find out who changed it",
            )


def _normal(statement: str) -> str:
    return " ".join(statement.split())


def migrate(db: sqlite3.Connection) -> None:
    """Migrate a record of version 1: its log becomes a tree, and nothing is lost."""
    if version(db) == VERSION:  # another command has done it
        return
    old = db.execute("SELECT at, what, subject, detail FROM log ORDER BY number").fetchall()
    db.execute("DROP TABLE log")  # and its triggers with it
    if db.execute("SELECT 1 FROM sqlite_master WHERE name = 'request'").fetchone():
        # The name of the grant request table in version 1; see rossec.authority.requests.
        db.execute("ALTER TABLE request RENAME TO grant_request")
    for statement in (*_VERSION_2, *_triggers(("log", "head", "answer"))):
        db.execute(statement)
    rows = {what: _rows_of(db, what) for what in LOGGED_TABLES}
    for number, (at, what, subject, detail) in enumerate(old):
        row = next(rows.get(what, iter(())), None)
        if row is None:
            raise LogDamaged(
                f"line {number} of the log is about a {what} that is not recorded",
                "restore a backup, and find out who changed the record",
            )
        append_entry(db, at, what, subject, detail, digest_of(row))
    (at,) = db.execute("SELECT coalesce(max(at), 0) FROM log").fetchone()
    append_entry(db, at, "migrated", "record", f"1 to {VERSION}", b"")
    db.execute(f"PRAGMA user_version = {VERSION}")


def append_entry(
    db: sqlite3.Connection, at: int, what: str, subject: str, detail: str, digest: bytes
) -> None:
    """Append an entry to the log, inside the transaction of the change it describes."""
    last = db.execute("SELECT number, peaks FROM log ORDER BY number DESC LIMIT 1").fetchone()
    number, peaks = (0, b"") if last is None else (last[0] + 1, last[1])
    entry = LogEntry(number, at, what, subject, detail, digest)
    db.execute("INSERT INTO log VALUES (?, ?, ?, ?, ?, ?, ?)", (*entry, extend_peaks(peaks, entry)))


def _rows_of(db: sqlite3.Connection, what: str) -> Iterator[tuple[int | str | bytes, ...]]:
    """The rows of the log entries of kind `what`, oldest first."""
    table, columns = LOGGED_TABLES[what]
    return iter(db.execute(f"SELECT {columns} FROM {table} ORDER BY rowid").fetchall())  # noqa: S608  (constants)


def _triggers(tables: tuple[str, ...]) -> Iterator[str]:
    for table in tables:
        for verb in ("UPDATE", "DELETE"):
            yield _NO_CHANGE.format(table=table, verb=verb)
    transitions = ", ".join(
        f"'{old}>{new}'" for old, following in TRANSITIONS.items() for new in sorted(following)
    )
    yield from (_NEW_REQUEST, _REQUEST_IMMUTABLE, _REQUEST_TRANSITIONS.format(allowed=transitions))
