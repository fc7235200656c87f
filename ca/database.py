"""The file of the authority's record: an SQLite database of its owner alone, durable and whole.

A shell. What the tables are, `ca.schema` knows; this module opens them, so that a foreign, damaged
or vanished file is refused and left as it is, and runs transactions: all of it on the disk when the
call returns, or nothing.
"""

import os
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, Self

from ca import schema
from ca.errors import StoreError

_RESTORE: Final = "is the disk full, or another command at work? else restore a backup"


class Database:
    """An open record. Make one with `create` or `open`."""

    def __init__(self, connection: sqlite3.Connection) -> None:
        self.connection = connection

    @classmethod
    def create(cls, path: Path) -> Self:
        """Make a new, empty record, readable by its owner alone.

        Raises:
            StoreError: the file exists, or its directory does not.
        """
        try:
            os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_RDWR | os.O_CLOEXEC, 0o600))
        except OSError as error:
            raise StoreError(f"cannot create {path}: {error.strerror}") from error
        database = cls(_connect(path))
        _configure(database.connection)
        with database.changing() as db:
            schema.create(db)
        return database

    @classmethod
    def open(cls, path: Path) -> Self:
        """Open an existing record; one of an older version is brought up first.

        Raises:
            StoreError: no file, not a record of rossec, damaged, or of a newer version.
        """
        _check_file(path)
        database = cls(_connect(path))
        try:
            _check_kind(database.connection, path)
            _configure(database.connection)
            database._bring_up()
        except (sqlite3.Error, StoreError) as error:
            database.close()
            if isinstance(error, StoreError):
                raise
            raise StoreError(f"{path} is damaged: {error}", "restore it from a backup") from error
        return database

    def close(self) -> None:
        """Close the file."""
        self.connection.close()

    def snapshot(self) -> bytes:
        """The whole file as of this moment, whatever others are writing.

        Raises:
            StoreError: the file is damaged or closed.
        """
        try:
            return self.connection.serialize()
        except sqlite3.Error as error:
            raise StoreError(f"the record cannot be read: {error}", _RESTORE) from error

    def rows(self, query: str, *values: object) -> list[Any]:
        """What `query` finds.

        Raises:
            StoreError: the file is damaged or closed.
        """
        try:
            return self.connection.execute(query, values).fetchall()
        except sqlite3.Error as error:
            raise StoreError(f"the record cannot be read: {error}", _RESTORE) from error

    @contextmanager
    def changing(self) -> Iterator[sqlite3.Connection]:
        """One transaction: all of it, durably, or nothing.

        Raises:
            StoreError: an entry is refused, or the file cannot be written.
        """
        try:
            self.connection.execute("BEGIN IMMEDIATE")
            with self.connection:
                yield self.connection
        except sqlite3.IntegrityError as error:
            raise StoreError(f"the record refuses the entry: {error}") from error
        except sqlite3.Error as error:
            raise StoreError(f"the record cannot be written: {error}", _RESTORE) from error

    def _bring_up(self) -> None:
        if schema.version(self.connection) != schema.VERSION:
            with self.changing() as db:
                schema.migrate(db)


def _check_file(path: Path) -> None:
    if not path.is_file():
        raise StoreError(f"there is no record at {path}", "restore it from a backup")
    if path.stat().st_mode & 0o077:
        raise StoreError(
            f"{path} can be read or written by others",
            f"it tells who may see what: chmod 600 {path}",
        )


def _connect(path: Path) -> sqlite3.Connection:
    try:
        return sqlite3.connect(
            f"{path.absolute().as_uri()}?mode=rw", timeout=10, isolation_level=None, uri=True
        )
    except sqlite3.Error as error:
        raise StoreError(f"{path} cannot be opened: {error}", _RESTORE) from error


def _check_kind(db: sqlite3.Connection, path: Path) -> None:
    """Before anything is set: another program's database must be left as it is."""
    (application,) = db.execute("PRAGMA application_id").fetchone()
    if application != schema.APPLICATION_ID or not 1 <= schema.version(db) <= schema.VERSION:
        raise StoreError(
            f"{path} is not a record of this version of rossec", "restore it, or update rossec"
        )


def _configure(db: sqlite3.Connection) -> None:
    for pragma in ("journal_mode = WAL", "synchronous = FULL", "trusted_schema = OFF"):
        db.execute(f"PRAGMA {pragma}")
