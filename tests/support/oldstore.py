"""A database with version 1 of the tables, and a row in every table."""

import os
import sqlite3
from contextlib import closing
from pathlib import Path

NOW, DAY = 1_800_000_000, 86_400
KEYS = [bytes([number]) * 32 for number in range(1, 6)]
_TABLES = """
CREATE TABLE certificate (
        serial BLOB PRIMARY KEY, name TEXT NOT NULL, thumbprint BLOB NOT NULL, der BLOB NOT NULL,
        not_before INTEGER NOT NULL, not_after INTEGER NOT NULL, at INTEGER NOT NULL
    ) STRICT;
CREATE INDEX certificate_name ON certificate (name, not_after);
CREATE TABLE grant_ (
        id BLOB PRIMARY KEY, name TEXT NOT NULL, data BLOB NOT NULL,
        not_before INTEGER NOT NULL, expires INTEGER NOT NULL, at INTEGER NOT NULL
    ) STRICT;
CREATE TABLE revocation (entry BLOB PRIMARY KEY, reason TEXT NOT NULL, at INTEGER NOT NULL)
        STRICT;
CREATE TABLE list (
        epoch INTEGER NOT NULL, seq INTEGER NOT NULL, data BLOB NOT NULL, at INTEGER NOT NULL,
        PRIMARY KEY (epoch, seq)
    ) STRICT;
CREATE TABLE log (number INTEGER PRIMARY KEY, at INTEGER NOT NULL, what TEXT NOT NULL,
        subject TEXT NOT NULL, detail TEXT NOT NULL) STRICT;
"""
_TRIGGER = """
CREATE TRIGGER {table}_no_{verb} BEFORE {verb} ON {table}
BEGIN SELECT RAISE(ABORT, 'the record is append-only'); END;
"""


def write_version_1(path: Path) -> None:
    """Write the file as the earlier release did."""
    os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_RDWR, 0o600))
    with closing(sqlite3.connect(path, isolation_level=None)) as db:
        db.execute("PRAGMA journal_mode = WAL")
        db.executescript(_TABLES)
        for table in ("certificate", "grant_", "revocation", "list", "log"):
            for verb in ("UPDATE", "DELETE"):
                db.execute(_TRIGGER.format(table=table, verb=verb))
        db.execute(f"PRAGMA application_id = {0x524F5343}")
        db.execute("PRAGMA user_version = 1")
        for number, key in enumerate(KEYS):
            _fill(db, number, key)


def _fill(db: sqlite3.Connection, number: int, key: bytes) -> None:
    name, at, entry = f"/node{number}", NOW + number, key[:16]
    certificate = (key[:20], name, key, b"der%d" % number, NOW, NOW + DAY, at)
    db.execute("INSERT INTO certificate VALUES (?, ?, ?, ?, ?, ?, ?)", certificate)
    db.execute("INSERT INTO grant_ VALUES (?, ?, ?, ?, ?, ?)", (entry, name, b"g", NOW, NOW, at))
    db.execute("INSERT INTO revocation VALUES (?, ?, ?)", (entry, "lost", at))
    db.execute("INSERT INTO list VALUES (?, ?, ?, ?)", (1, number + 1, b"list", at))
    for line in (
        ("certificate", name, key.hex()),
        ("grant", name, entry.hex()),
        ("revocation", entry.hex(), "lost"),
        ("list", f"1.{number + 1}", ""),
    ):
        db.execute("INSERT INTO log (at, what, subject, detail) VALUES (?, ?, ?, ?)", (at, *line))
