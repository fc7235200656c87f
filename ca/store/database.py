"""The database file of the authority's record: SQLite, private to its owner, durable transactions.

Does I/O. `ca.store.schema` defines the tables. This module opens the file, refusing a foreign,
damaged or missing one without changing it, and runs transactions, which are on the disk when the
call returns. What is read to decide a change must be read inside `transaction`, which excludes
every other command until the change is made.
"""

import os
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final, Self

from ca.errors import StoreError
from ca.keys import ownership
from ca.store import migration, schema
from ca.store.faults import fault

BUSY_TIMEOUT: Final = 30.0  # seconds; other commands hold the lock for milliseconds
# The statements that begin, commit and roll back a transaction, and a nested one.
_TRANSACTION: Final = ("BEGIN IMMEDIATE", "COMMIT", ("ROLLBACK",))
_SAVEPOINT: Final = ("SAVEPOINT part", "RELEASE part", ("ROLLBACK TO part", "RELEASE part"))


class Database:
    """An open database. Create it with `create` or `open`."""

    def __init__(self, connection: sqlite3.Connection, path: Path) -> None:
        self.connection = connection
        self._path = path.absolute()
        found = path.stat()
        self._file = found.st_dev, found.st_ino

    @classmethod
    def create(cls, path: Path) -> Self:
        """Create a new, empty record, readable only by its owner.

        Raises:
            StoreError: the file exists, or its directory does not.
        """
        try:
            os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_RDWR | os.O_CLOEXEC, 0o600))
        except OSError as error:
            raise StoreError(f"cannot create {path}: {error.strerror}") from error
        database = cls(_connect(path), path)
        try:
            _configure(database.connection)
        except sqlite3.Error as error:
            raise fault(path, error) from error
        with database.transaction() as db:
            schema.create(db)
        return database

    @classmethod
    def open(cls, path: Path) -> Self:
        """Open an existing record; an older version is migrated first.

        Raises:
            StoreError: no file, not a record of rossec, damaged, or of a newer version; or it
                cannot be used now.
            PathRefused: another user owns it, or could have written it.
        """
        _check_file(path)
        database = cls(_connect(path), path)
        try:
            _check_kind(database.connection, path)
            _configure(database.connection)
            database._migrate()
        except (sqlite3.Error, StoreError) as error:
            database.close()
            if isinstance(error, StoreError):
                raise
            raise fault(path, error) from error
        return database

    def close(self) -> None:
        """Close the file."""
        self.connection.close()

    def snapshot(self) -> bytes:
        """The whole file as of this moment, also while others write.

        Raises:
            StoreError: the file is damaged or closed.
        """
        try:
            return self.connection.serialize()
        except sqlite3.Error as error:
            raise fault(self._path, error) from error

    def rows(self, query: str, *values: object) -> list[Any]:
        """The rows that `query` selects.

        Raises:
            StoreError: the file is damaged or closed.
        """
        try:
            return self.connection.execute(query, values).fetchall()
        except sqlite3.Error as error:
            raise fault(self._path, error) from error

    def check(self) -> None:
        """Return if the file is undamaged and has only the triggers and views of rossec.

        Raises:
            StoreError: see `ca.store.schema.check_no_foreign_objects`; or the file is damaged.
        """
        try:
            schema.check_no_foreign_objects(self.connection)
            found = self.connection.execute("PRAGMA quick_check").fetchall()
        except sqlite3.Error as error:
            raise fault(self._path, error) from error
        if found != [("ok",)]:
            raise StoreError(f"{self._path} is damaged: {found[0][0]}", "restore another backup")

    @contextmanager
    def transaction(self) -> Iterator[sqlite3.Connection]:
        """An exclusive transaction: all of it, durably, or nothing.

        A nested one is rolled back alone if it fails, and committed with the outer one.

        Raises:
            StoreError: an entry is refused, the file cannot be written, or it was replaced.
        """
        try:
            begin, commit, rollback = _SAVEPOINT if self.connection.in_transaction else _TRANSACTION
            self.connection.execute(begin)
            try:
                self._check_not_replaced()
                yield self.connection
                self.connection.execute(commit)
            except BaseException:
                if self.connection.in_transaction:  # a full disk ends the transaction
                    for statement in rollback:
                        self.connection.execute(statement)
                raise
        except sqlite3.Error as error:
            raise fault(self._path, error) from error

    @contextmanager
    def read_transaction(self) -> Iterator[None]:
        """A read transaction: a consistent snapshot, also while others write."""
        if self.connection.in_transaction:
            yield
            return
        self.rows("BEGIN")
        try:
            yield
        finally:
            self.connection.execute("ROLLBACK")

    def _check_not_replaced(self) -> None:
        """Refuse to write to a record that was moved away while this command waited."""
        try:
            found = self._path.stat()
        except OSError:
            found = None
        if found is None or (found.st_dev, found.st_ino) != self._file:
            raise StoreError(
                f"{self._path} was replaced by another command, nothing was changed",
                "run the command again: it then uses the new record",
            )

    def _migrate(self) -> None:
        if schema.version(self.connection) != schema.VERSION:
            with self.transaction() as db:
                migration.migrate(db)
        schema.check(self.connection)


def _check_file(path: Path) -> None:
    if not path.is_file():
        raise StoreError(f"there is no record at {path}", "restore it from a backup")
    if path.stat().st_mode & 0o077:
        raise StoreError(
            f"{path} can be read or written by others",
            f"it contains grants and identities: chmod 600 {path}",
        )
    with suppress(FileNotFoundError):  # SQLite reports it
        ownership.check_trusted(path)


def _connect(path: Path) -> sqlite3.Connection:
    try:
        return sqlite3.connect(
            f"{path.absolute().as_uri()}?mode=rw",
            timeout=BUSY_TIMEOUT,
            isolation_level=None,
            uri=True,
        )
    except sqlite3.Error as error:
        raise fault(path, error) from error


def _check_kind(db: sqlite3.Connection, path: Path) -> None:
    """Before any PRAGMA is set: a database of another program must not be changed."""
    (application,) = db.execute("PRAGMA application_id").fetchone()
    if application == schema.APPLICATION_ID and schema.version(db) > schema.VERSION:
        raise StoreError(
            f"{path} was written by a newer version of rossec",
            "use that version; to go back, move the directory away and restore the backup from"
            " before the update: rossec ca restore FILE --list FILE",
        )
    if application != schema.APPLICATION_ID or schema.version(db) < 1:
        raise StoreError(f"{path} is not a record of rossec", "restore it from a backup")


def _configure(db: sqlite3.Connection) -> None:
    for pragma in ("journal_mode = WAL", "synchronous = FULL", "trusted_schema = OFF"):
        db.execute(f"PRAGMA {pragma}")
