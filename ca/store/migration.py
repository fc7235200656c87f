"""Older versions of the record are brought up to the present one, and lose nothing.

Version 2 made a tree of the log. Version 3 took the requests for grants and their answers into the
log, which until then were tables of their own, and knows which grants came from a policy: those
signed before count as made by hand. Version 4 adds passkeys and approvals, version 5 foreign
domains, version 6 constrained things, of which there were none. Each step runs inside the caller's
transaction.
"""

import sqlite3
from collections.abc import Iterator
from typing import Any, Final

from ca.errors import LogDamaged
from ca.store import schema
from ca.store.log_entries import digest_of

_OF_VERSION_1: Final = ("certificate", "grant", "revocation", "list")  # kinds of log entries


def migrate(db: sqlite3.Connection) -> None:
    """Bring a record up to the present version; another command may have done it."""
    if schema.version(db) == 1:
        _to_version_2(db)
        _finish(db, 2)
    if schema.version(db) == 2:
        _to_version_3(db)
        _finish(db, 3)
    if schema.version(db) == 3:
        _add_tables(db, schema.VERSION_4, schema.APPROVALS)
        _finish(db, 4)
    if schema.version(db) == 4:
        _add_tables(db, schema.VERSION_5, schema.DOMAINS)
        _finish(db, 5)
    if schema.version(db) == 5:
        _add_tables(db, schema.VERSION_6, schema.THINGS)
        _finish(db, 6)


def _to_version_2(db: sqlite3.Connection) -> None:
    old = db.execute("SELECT at, what, subject, detail FROM log ORDER BY number").fetchall()
    db.execute("DROP TABLE log")  # and its triggers with it
    if _has_table(db, "request"):  # requests for grants: the name is not theirs any more
        db.execute("ALTER TABLE request RENAME TO grant_request")
    tables = ("log", "head", schema.ANSWERS)
    for statement in (
        *schema.VERSION_2, *schema.append_only_triggers(tables), *schema.request_triggers(),
    ):  # fmt: skip
        db.execute(statement)
    rows = {what: _rows_of(db, what) for what in _OF_VERSION_1}
    for number, (at, what, subject, detail) in enumerate(old):
        row = next(rows.get(what, iter(())), None)
        if row is None:
            raise LogDamaged(
                f"line {number} of the log is about a {what} that is not recorded",
                "restore a backup, and find out who changed the record",
            )
        schema.append_entry(db, at, what, subject, detail, digest_of(row))


def _to_version_3(db: sqlite3.Connection) -> None:
    requests = _taken(db, "grant_request", "id, name, data, at")
    decisions = _taken(db, "decision", "request, right, pattern, answer, reason, at")
    for statement in (*schema.VERSION_3, *schema.append_only_triggers(schema.DECISIONS)):
        db.execute(statement)
    for row in requests:
        db.execute("INSERT INTO grant_request VALUES (?, ?, ?, ?)", row)
        schema.append_entry(db, row[3], "grant request", row[1], row[0].hex(), digest_of(row))
    names = {row[0]: row[1] for row in requests}
    for row in decisions:
        db.execute("INSERT INTO decision VALUES (?, ?, ?, ?, ?, ?)", row)
        subject = names.get(row[0], "")
        schema.append_entry(db, row[5], "decision", subject, f"{row[3]} {row[2]}", digest_of(row))


def _add_tables(
    db: sqlite3.Connection, statements: tuple[str, ...], append_only: tuple[str, ...]
) -> None:
    for statement in (*statements, *schema.append_only_triggers(append_only)):
        db.execute(statement)


def _taken(db: sqlite3.Connection, table: str, columns: str) -> list[tuple[Any, ...]]:
    """The rows of a table that may not be there, oldest first; the table is dropped."""
    if not _has_table(db, table):
        return []
    rows = db.execute(f"SELECT {columns} FROM {table} ORDER BY rowid").fetchall()  # noqa: S608  (constants)
    db.execute(f"DROP TABLE {table}")  # and its triggers with it
    return rows


def _finish(db: sqlite3.Connection, version: int) -> None:
    (at,) = db.execute("SELECT coalesce(max(at), 0) FROM log").fetchone()
    schema.append_entry(db, at, "migrated", "record", f"{version - 1} to {version}", b"")
    db.execute(f"PRAGMA user_version = {version}")


def _has_table(db: sqlite3.Connection, name: str) -> bool:
    query = "SELECT 1 FROM sqlite_master WHERE type = 'table' AND name = ?"
    return db.execute(query, (name,)).fetchone() is not None


def _rows_of(db: sqlite3.Connection, what: str) -> Iterator[tuple[int | str | bytes, ...]]:
    """The rows of the log entries of kind `what`, oldest first."""
    table, columns = schema.LOGGED_TABLES[what]
    return iter(db.execute(f"SELECT {columns} FROM {table} ORDER BY rowid").fetchall())  # noqa: S608  (constants)
