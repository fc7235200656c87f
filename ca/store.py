"""The authority's record: what was signed, for whom, and what was taken back. SQLite, append-only.

A shell. Nothing is ever changed or deleted (triggers refuse it): a certificate that was handed out
exists, and a revocation cannot be undone. Every change appends its line to the log in the same
transaction, and is on the disk when the call returns.
"""

import os
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, NamedTuple, Self

from ca import names, svid
from ca.errors import KeyChanged, NameCovered, StoreError

APPLICATION_ID: Final = 0x524F5343  # "ROSC"
VERSION: Final = 1
_TABLES: Final = ("certificate", "grant_", "revocation", "list", "log")
_SCHEMA: Final = (
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
    """CREATE TABLE log (number INTEGER PRIMARY KEY, at INTEGER NOT NULL, what TEXT NOT NULL,
        subject TEXT NOT NULL, detail TEXT NOT NULL) STRICT""",
)
_APPEND_ONLY: Final = """
CREATE TRIGGER {table}_no_{verb} BEFORE {verb} ON {table}
BEGIN SELECT RAISE(ABORT, 'the record is append-only'); END;
"""


class CertificateRow(NamedTuple):
    """One identity that was signed."""

    serial: int
    name: str
    thumbprint: bytes
    der: bytes
    not_before: int
    not_after: int

    @property
    def wildcard(self) -> bool:
        """Whether it also stands for anonymous nodes."""
        return svid.is_wildcard(self.der)

    def covers(self, name: str) -> bool:
        """Whether its holder may go by `name`."""
        related = names.covers(self.name, name, wildcard=True)
        return related and (self.name == name or self.wildcard)


class GrantRow(NamedTuple):
    """One grant that was signed."""

    id: bytes
    name: str
    data: bytes
    not_before: int
    expires: int


class LogRow(NamedTuple):
    """One thing that was done."""

    at: int
    what: str
    subject: str
    detail: str


class Store:
    """An open record. Make one with `create` or `open`."""

    def __init__(self, connection: sqlite3.Connection) -> None:
        self._db = connection

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
        store = cls(_connect(path))
        _configure(store._db)
        with store._changing() as db:
            for statement in (*_SCHEMA, *_triggers()):
                db.execute(statement)
            db.execute(f"PRAGMA application_id = {APPLICATION_ID}")
            db.execute(f"PRAGMA user_version = {VERSION}")
        return store

    @classmethod
    def open(cls, path: Path) -> Self:
        """Open an existing record.

        Raises:
            StoreError: no file, not a record of rossec, damaged, or of a newer version.
        """
        _check_file(path)
        db = _connect(path)
        try:
            _check_kind(db, path)
            _configure(db)
        except (sqlite3.Error, StoreError) as error:
            db.close()
            if isinstance(error, StoreError):
                raise
            raise StoreError(f"{path} is damaged: {error}", "restore it from a backup") from error
        return cls(db)

    def close(self) -> None:
        """Close the file."""
        self._db.close()

    def add_certificate(
        self, row: CertificateRow, now: int, *, allow_new_key: bool = False
    ) -> None:
        """Record an identity before it is handed out.

        Raises:
            KeyChanged: the name is alive with another key, and that was not explicitly allowed.
            NameCovered: another living identity has a wildcard tail that covers the name, or the
                other way round.
            StoreError: the key is revoked, or the serial is taken.
        """
        with self._changing() as db:
            if row.thumbprint in self.revoked_entries():
                raise StoreError(
                    f"the key of {row.name} is revoked", "have the node make a new key and request"
                )
            self._check_names(row, now)
            if not allow_new_key:
                self._check_key(row, now)
            serial = row.serial.to_bytes(20)
            db.execute(
                "INSERT INTO certificate VALUES (?, ?, ?, ?, ?, ?, ?)",
                (serial, row.name, row.thumbprint, row.der, row.not_before, row.not_after, now),
            )
            _log(db, now, "certificate", row.name, row.thumbprint.hex())

    def certificates(self) -> list[CertificateRow]:
        """Every identity signed, oldest first."""
        rows = self._rows(
            "SELECT serial, name, thumbprint, der, not_before, not_after FROM certificate"
            " ORDER BY rowid"
        )
        return [CertificateRow(int.from_bytes(serial), *rest) for serial, *rest in rows]

    def live_keys(self, name: str, now: int) -> frozenset[bytes]:
        """Thumbprints of the keys with which `name` can still prove itself."""
        alive = {
            row.thumbprint
            for row in self.certificates()
            if row.name == name and now <= row.not_after
        }
        return frozenset(alive) - self.revoked_entries()

    def certified(self, name: str, now: int) -> str:
        """The name under which grants, rules and revocations are for the node called `name`.

        Its own, unless it is an anonymous one: then that of the living identity that covers it.
        """
        revoked = self.revoked_entries()
        covering = (
            row.name
            for row in self.certificates()
            if now <= row.not_after and row.thumbprint not in revoked and row.covers(name)
        )
        return max(covering, key=len, default=name)

    def live_certificate(self, name: str, now: int) -> CertificateRow:
        """The newest identity of `name` that is still valid and not revoked.

        Raises:
            StoreError: there is none.
        """
        keys = self.live_keys(name, now)
        alive = [
            row
            for row in self.certificates()
            if row.name == name and row.thumbprint in keys and now <= row.not_after
        ]
        if not alive:
            certified = self.certified(name, now)
            raise StoreError(
                f"{name} has no valid identity here",
                f"first enroll it: rossec node request {name}, then rossec ca sign"
                if certified == name
                else f"it is one of the anonymous nodes of {certified}: name that",
            )
        return alive[-1]

    def add_grant(self, row: GrantRow, now: int) -> None:
        """Record a grant before it is handed out.

        Raises:
            StoreError: the id is taken.
        """
        with self._changing() as db:
            db.execute("INSERT INTO grant_ VALUES (?, ?, ?, ?, ?, ?)", (*row, now))
            _log(db, now, "grant", row.name, row.id.hex())

    def grants(self) -> list[GrantRow]:
        """Every grant signed, oldest first."""
        rows = self._rows("SELECT id, name, data, not_before, expires FROM grant_ ORDER BY rowid")
        return [GrantRow(*row) for row in rows]

    def revoke(self, entry: bytes, reason: str, now: int) -> None:
        """Record that a grant id or key thumbprint is revoked; twice is once."""
        with self._changing() as db:
            done = db.execute(
                "INSERT INTO revocation VALUES (?, ?, ?) ON CONFLICT DO NOTHING",
                (entry, reason, now),
            )
            if done.rowcount:
                _log(db, now, "revocation", entry.hex(), reason)

    def revoked_entries(self) -> frozenset[bytes]:
        """Everything revoked."""
        return frozenset(entry for (entry,) in self._rows("SELECT entry FROM revocation"))

    def next_number(self) -> tuple[int, int]:
        """Epoch and sequence number for the next revocation list."""
        rows = self._rows("SELECT epoch, seq FROM list ORDER BY epoch DESC, seq DESC LIMIT 1")
        return (rows[0][0], rows[0][1] + 1) if rows else (1, 1)

    def save_list(self, number: tuple[int, int], data: bytes, now: int) -> None:
        """Record a signed revocation list.

        Raises:
            StoreError: its number is taken.
        """
        with self._changing() as db:
            db.execute("INSERT INTO list VALUES (?, ?, ?, ?)", (*number, data, now))
            _log(db, now, "list", f"{number[0]}.{number[1]}", "")

    def newest_list(self) -> bytes | None:
        """The signed revocation list with the highest number, if there is one."""
        rows = self._rows("SELECT data FROM list ORDER BY epoch DESC, seq DESC LIMIT 1")
        return bytes(rows[0][0]) if rows else None

    def log(self) -> list[LogRow]:
        """Everything that was done, oldest first."""
        rows = self._rows("SELECT at, what, subject, detail FROM log ORDER BY number")
        return [LogRow(*row) for row in rows]

    def _check_key(self, row: CertificateRow, now: int) -> None:
        """A name changes its key only when the operator says so, or the old key is revoked."""
        revoked = self.revoked_entries()
        for known in self.certificates():
            alive = known.name == row.name and now <= known.not_after
            if alive and known.thumbprint not in {row.thumbprint, *revoked}:
                raise KeyChanged(
                    f"{row.name} has an identity with another key until it expires",
                    "was the node set up anew? then say so with --new-key; if not, refuse",
                )

    def _check_names(self, row: CertificateRow, now: int) -> None:
        """No two keys may go by one name, also not through a wildcard tail."""
        revoked = self.revoked_entries()
        for known in self.certificates():
            alive = now <= known.not_after and known.thumbprint not in {row.thumbprint, *revoked}
            one = known.covers(row.name) or row.covers(known.name)
            if alive and known.name != row.name and one:
                raise NameCovered(
                    f"{row.name} and {known.name}: one is for anonymous nodes and covers the other",
                    f"choose another name, or revoke {known.name} first",
                )

    def _rows(self, query: str) -> list[Any]:
        try:
            return self._db.execute(query).fetchall()
        except sqlite3.Error as error:
            raise StoreError(f"the record cannot be read: {error}", _RESTORE) from error

    @contextmanager
    def _changing(self) -> Iterator[sqlite3.Connection]:
        """One transaction: all of it, durably, or nothing."""
        try:
            self._db.execute("BEGIN IMMEDIATE")
            with self._db:
                yield self._db
        except sqlite3.IntegrityError as error:
            raise StoreError(f"the record refuses the entry: {error}") from error
        except sqlite3.Error as error:
            raise StoreError(f"the record cannot be written: {error}", _RESTORE) from error


_RESTORE: Final = "is the disk full, or another command at work? else restore a backup"


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
    (version,) = db.execute("PRAGMA user_version").fetchone()
    if application != APPLICATION_ID or version != VERSION:
        raise StoreError(
            f"{path} is not a record of this version of rossec", "restore it, or update rossec"
        )


def _configure(db: sqlite3.Connection) -> None:
    for pragma in ("journal_mode = WAL", "synchronous = FULL", "trusted_schema = OFF"):
        db.execute(f"PRAGMA {pragma}")


def _log(db: sqlite3.Connection, now: int, what: str, subject: str, detail: str) -> None:
    db.execute(
        "INSERT INTO log (at, what, subject, detail) VALUES (?, ?, ?, ?)",
        (now, what, subject, detail),
    )


def _triggers() -> Iterator[str]:
    for table in _TABLES:
        for verb in ("UPDATE", "DELETE"):
            yield _APPEND_ONLY.format(table=table, verb=verb)
