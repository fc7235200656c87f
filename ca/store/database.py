"""The database file of the authority's record: SQLite, private to its owner, durable transactions.

All tables but that of requests for identities are append-only. Every table in `LOGGED_TABLES` has its
rows in the log. A foreign, damaged or missing file is refused without changing it. What is read to
decide a change must be read inside `transaction`, which excludes every other command until then.
"""

import os
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final, Self

from ca.errors import RecordUnusable, StoreError
from ca.keys import ownership
from ca.store.values import TRANSITIONS, LogEntry, RequestState, extend_peaks

_FULL_HINT: Final = "make room and run the command again; do not restore a backup"
_MIN_FREE: Final = 128 * 1024  # bytes of free space that SQLite needs to open a record
_DAMAGED: Final = frozenset({sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB})
_FAULTS: Final[dict[int, tuple[str, str]]] = {
    sqlite3.SQLITE_FULL: ("the disk is full, nothing was changed", _FULL_HINT),
    sqlite3.SQLITE_BUSY: (
        "another command is using it, nothing was changed",
        "run the command again when that one has ended",
    ),
    sqlite3.SQLITE_READONLY: (
        "it is read-only, nothing was changed",
        "is the file system mounted read-only, or the file another user's?",
    ),
    sqlite3.SQLITE_IOERR: (
        "the disk reports an error, nothing was changed",
        "is it full or failing? see: df, dmesg; check the record: rossec ca log verify",
    ),
}

APPLICATION_ID: Final = 0x524F5343  # "ROSC"
VERSION: Final = 6  # of the schema; 1 to 5 were those of development versions, which nobody brings up
_RESTORE_HINT: Final = "restore a backup of your own, and find out who made this one"
_APPROVAL: Final = (
    "id, kind, subject, statement, payload, passkey, client_data, authenticator_data, signature, at"
)
# For each kind of log entry: the table, and the columns in the order of the digest.
LOGGED_TABLES: Final = {
    "certificate": ("certificate", "serial, name, thumbprint, der, not_before, not_after"),
    "grant": ("grant_", "id, name, data, not_before, expires"),
    "revocation": ("revocation", "entry, reason"),
    "list": ("list", "epoch, seq, data"),
    "grant request": ("grant_request", "id, name, data, at"),
    "decision": ("decision", "request, right, pattern, answer, reason, at"),
    "policy grant": ("policy_grant", "id, rules"),
    "invitation": ("invitation", "id, key, pattern, uses, wildcard, expires, at"),
    "join": ("invitation_use", "invitation, request, name, thumbprint, at"),
    "invitation ended": ("invitation_end", "invitation, reason, at"),
    "passkey": ("passkey", "id, name, cose_key, aaguid, rp_id, origin, approval, at"),
    "passkey ended": ("passkey_end", "passkey, reason, at"),
    "approval": ("approval", _APPROVAL),
    "approval ended": ("approval_end", "approval, state, result, at"),
    "domain": ("foreign_domain", "number, domain, label, root, terms, at"),
    "domain ended": ("foreign_domain_end", "number, reason, at"),
    "domain list": ("domain_list", "epoch, seq, data"),
    "foreign certificate": ("foreign_certificate", "thumbprint, root, name, der, at"),
    "thing": ("thing", "id, name, border, data, not_before, expires"),
}

_TABLES: Final = (
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
    """CREATE TABLE grant_request (
        id BLOB PRIMARY KEY, name TEXT NOT NULL, data BLOB NOT NULL, at INTEGER NOT NULL
    ) STRICT""",
    """CREATE TABLE decision (
        request BLOB NOT NULL, right INTEGER NOT NULL, pattern TEXT NOT NULL,
        answer TEXT NOT NULL, reason TEXT NOT NULL, at INTEGER NOT NULL,
        PRIMARY KEY (request, right, pattern)
    ) STRICT""",
    # The grants that `policy apply` signed, and the rules they came from; all others are by hand.
    "CREATE TABLE policy_grant (id BLOB PRIMARY KEY, rules TEXT NOT NULL) STRICT",
    """CREATE TABLE invitation (
        id BLOB PRIMARY KEY, key BLOB NOT NULL, pattern TEXT NOT NULL, uses INTEGER NOT NULL,
        wildcard INTEGER NOT NULL, expires INTEGER NOT NULL, at INTEGER NOT NULL
    ) STRICT""",
    # A request uses one invitation, once.
    """CREATE TABLE invitation_use (
        invitation BLOB NOT NULL, request BLOB PRIMARY KEY, name TEXT NOT NULL,
        thumbprint BLOB NOT NULL, at INTEGER NOT NULL
    ) STRICT""",
    """CREATE TABLE invitation_end (
        invitation BLOB PRIMARY KEY, reason TEXT NOT NULL, at INTEGER NOT NULL
    ) STRICT""",
    """CREATE TABLE passkey (
        id BLOB PRIMARY KEY, name TEXT NOT NULL, cose_key BLOB NOT NULL, aaguid BLOB NOT NULL,
        rp_id TEXT NOT NULL, origin TEXT NOT NULL, approval BLOB NOT NULL, at INTEGER NOT NULL
    ) STRICT""",
    """CREATE TABLE passkey_end (
        passkey BLOB PRIMARY KEY, reason TEXT NOT NULL, at INTEGER NOT NULL
    ) STRICT""",
    # The id is that of the statement: one statement is approved once.
    """CREATE TABLE approval (
        id BLOB PRIMARY KEY, kind INTEGER NOT NULL, subject BLOB NOT NULL,
        statement BLOB NOT NULL, payload BLOB NOT NULL, passkey BLOB NOT NULL,
        client_data BLOB NOT NULL, authenticator_data BLOB NOT NULL, signature BLOB NOT NULL,
        at INTEGER NOT NULL
    ) STRICT""",
    "CREATE INDEX approval_subject ON approval (kind, subject)",
    "CREATE INDEX approval_passkey ON approval (passkey)",
    """CREATE TABLE approval_end (
        approval BLOB PRIMARY KEY, state TEXT NOT NULL, result TEXT NOT NULL, at INTEGER NOT NULL
    ) STRICT""",
    # Each acceptance, and each change of its terms, is a row: the newest one of a domain counts.
    """CREATE TABLE foreign_domain (
        number INTEGER PRIMARY KEY, domain TEXT NOT NULL, label TEXT NOT NULL,
        root BLOB NOT NULL, terms BLOB NOT NULL, at INTEGER NOT NULL
    ) STRICT""",
    """CREATE TABLE foreign_domain_end (
        number INTEGER NOT NULL UNIQUE, reason TEXT NOT NULL, at INTEGER NOT NULL
    ) STRICT""",
    """CREATE TABLE domain_list (
        epoch INTEGER NOT NULL, seq INTEGER NOT NULL, data BLOB NOT NULL, at INTEGER NOT NULL,
        PRIMARY KEY (epoch, seq)
    ) STRICT""",
    # The keys of foreign nodes that grants were signed for, as proved by their certificates.
    """CREATE TABLE foreign_certificate (
        thumbprint BLOB NOT NULL, root BLOB NOT NULL, name TEXT NOT NULL, der BLOB NOT NULL UNIQUE,
        at INTEGER NOT NULL
    ) STRICT""",
    # Statements about constrained things; `border` is the name of the router that serves it.
    """CREATE TABLE thing (
        id BLOB PRIMARY KEY, name TEXT NOT NULL, border TEXT NOT NULL, data BLOB NOT NULL,
        not_before INTEGER NOT NULL, expires INTEGER NOT NULL, at INTEGER NOT NULL
    ) STRICT""",
)
# Triggers stop mistakes, ours too; who owns the file can drop them, and is found by the log's signed heads.
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

BUSY_TIMEOUT: Final = 30.0  # seconds; other commands hold the lock for milliseconds
# The statements that begin, commit and roll back a transaction, and a nested one.
_TRANSACTION: Final = ("BEGIN IMMEDIATE", "COMMIT", ("ROLLBACK",))
_SAVEPOINT: Final = ("SAVEPOINT part", "RELEASE part", ("ROLLBACK TO part", "RELEASE part"))


def fault(path: Path, error: sqlite3.Error) -> StoreError:
    # Only what SQLite reports as corrupt is called damaged, and must be restored: a backup lacks the
    # revocations made since (https://sqlite.org/rescode.html).
    code = getattr(error, "sqlite_errorcode", sqlite3.SQLITE_ERROR) & 0xFF  # the primary code
    if code in _DAMAGED:
        return RecordUnusable(f"{path} is damaged: {error}", "restore it from a backup, with --list")
    if code == sqlite3.SQLITE_CONSTRAINT:
        return StoreError(f"the record refuses the entry: {error}")
    if code in {sqlite3.SQLITE_IOERR, sqlite3.SQLITE_CANTOPEN}:  # said of a full disk too
        with suppress(OSError):
            found = os.statvfs(path.parent)
            if found.f_bavail * found.f_frsize < _MIN_FREE:
                code = sqlite3.SQLITE_FULL
    what, hint = _FAULTS.get(code, (f"{error}, nothing was changed", "run the command again"))
    return RecordUnusable(f"{path} cannot be used: {what}", hint)


@contextmanager
def _faults(path: Path) -> Iterator[None]:
    try:
        yield
    except sqlite3.Error as error:
        raise fault(path, error) from error


def create(db: sqlite3.Connection) -> None:
    for statement in _TABLES:
        db.execute(statement)
        kind, name = statement.split()[1:3]
        if kind == "TABLE" and name != "csr":  # requests for identities change, and end
            for verb in ("UPDATE", "DELETE"):
                db.execute(_NO_CHANGE.format(table=name, verb=verb))
    transitions = [f"'{old}>{new}'" for old, following in TRANSITIONS.items() for new in sorted(following)]
    db.execute(_NEW_REQUEST)
    db.execute(_REQUEST_IMMUTABLE)
    db.execute(_REQUEST_TRANSITIONS.format(allowed=", ".join(transitions)))
    db.execute(f"PRAGMA application_id = {APPLICATION_ID}")
    db.execute(f"PRAGMA user_version = {VERSION}")


def check_no_foreign_objects(db: sqlite3.Connection) -> None:
    """Return if this file has no other tables, triggers and views than those created here."""
    # A trigger could drop an inserted row, a view or a virtual table could replace a table.
    expected_db = sqlite3.connect(":memory:")
    create(expected_db)
    expected, found = _objects(expected_db), _objects(db)
    expected_db.close()
    for name, created in found.items():
        if expected.get(name) != created:
            raise StoreError(f"the record holds a {created[0]} that is not rossec's: {name!a}", _RESTORE_HINT)
    if missing := expected.keys() - found.keys():
        raise StoreError(f"the record lacks {min(missing)}", _RESTORE_HINT)


def _objects(db: sqlite3.Connection) -> dict[str, tuple[str, str, list[str]]]:
    rows = db.execute("SELECT name, type, tbl_name, sql FROM sqlite_master WHERE sql IS NOT NULL")
    return {name: (kind, table, text.split()) for name, kind, table, text in rows}


def check(db: sqlite3.Connection) -> None:
    rows = db.execute("SELECT name, sql FROM sqlite_master WHERE type = 'table'")
    found = {name: sql.split() for name, sql in rows}
    for statement in _TABLES:
        kind, name = statement.split()[1:3]
        if kind == "TABLE" and found.get(name) != statement.split():
            raise StoreError(
                f"the table {name} of the record differs from rossec's schema",
                "restore it from a backup of your own, and find out who changed it",
            )


def append_entry(
    db: sqlite3.Connection, at: int, what: str, subject: str, detail: str, digest: bytes
) -> None:
    """Append an entry to the log, inside the transaction of the change it describes."""
    # With the tree's peaks in each entry, an append costs the same for the first and the millionth.
    last = db.execute("SELECT number, peaks FROM log ORDER BY number DESC LIMIT 1").fetchone()
    number, peaks = (0, b"") if last is None else (last[0] + 1, last[1])
    entry = LogEntry(number, at, what, subject, detail, digest)
    db.execute("INSERT INTO log VALUES (?, ?, ?, ?, ?, ?, ?)", (*entry, extend_peaks(peaks, entry)))


class Database:
    def __init__(self, connection: sqlite3.Connection, path: Path) -> None:
        self.connection = connection
        self._path = path.absolute()
        found = path.stat()
        self._file = found.st_dev, found.st_ino

    @classmethod
    def create(cls, path: Path) -> Self:
        try:
            os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_RDWR | os.O_CLOEXEC, 0o600))
        except OSError as error:
            raise StoreError(f"cannot create {path}: {error.strerror}") from error
        database = cls(_connect(path), path)
        with _faults(path):
            _configure(database.connection)
        with database.transaction() as db:
            create(db)
        return database

    @classmethod
    def open(cls, path: Path) -> Self:
        if not path.is_file():
            raise StoreError(f"there is no record at {path}", "restore it from a backup")
        if path.stat().st_mode & 0o077:
            raise StoreError(
                f"{path} can be read or written by others",
                f"it contains grants and identities: chmod 600 {path}",
            )
        with suppress(FileNotFoundError):  # SQLite reports it
            ownership.check_trusted(path)
        database = cls(_connect(path), path)
        try:
            # Before any PRAGMA is set: a database of another program must not be changed.
            db = database.connection
            (application,) = db.execute("PRAGMA application_id").fetchone()
            (version,) = db.execute("PRAGMA user_version").fetchone()
            if application == APPLICATION_ID and version > VERSION:
                raise StoreError(
                    f"{path} was written by a newer version of rossec",
                    "use that version; to go back, move the directory away and restore the backup from"
                    " before the update: rossec ca restore FILE --list FILE",
                )
            if (application, version) != (APPLICATION_ID, VERSION):
                raise StoreError(f"{path} is not a record of rossec", "restore it from a backup")
            _configure(db)
            check(db)
        except (sqlite3.Error, StoreError) as error:
            database.close()
            if isinstance(error, StoreError):
                raise
            raise fault(path, error) from error
        return database

    def close(self) -> None:
        self.connection.close()

    def snapshot(self) -> bytes:
        """The whole file as of this moment, also while others write."""
        with _faults(self._path):
            return self.connection.serialize()

    def logged(self, what: str, clause: str = "ORDER BY rowid", *values: object) -> list[Any]:
        """The rows about which log entries of the kind `what` are, with the columns of the digest."""
        table, columns = LOGGED_TABLES[what]
        return self.rows(f"SELECT {columns} FROM {table} {clause}", *values)  # noqa: S608  (constants)

    def rows(self, query: str, *values: object) -> list[Any]:
        try:
            return self.connection.execute(query, values).fetchall()
        except sqlite3.Error as error:
            raise fault(self._path, error) from error

    def check(self) -> None:
        """Return if the file is undamaged and has only the triggers and views of rossec."""
        with _faults(self._path):
            check_no_foreign_objects(self.connection)
            found = self.connection.execute("PRAGMA quick_check").fetchall()
        if found != [("ok",)]:
            raise StoreError(f"{self._path} is damaged: {found[0][0]}", "restore another backup")

    @contextmanager
    def transaction(self) -> Iterator[sqlite3.Connection]:
        """An exclusive transaction: all of it, durably, or nothing."""
        # A nested one is rolled back alone if it fails, and committed with the outer one.
        with _faults(self._path):
            begin, commit, rollback = _SAVEPOINT if self.connection.in_transaction else _TRANSACTION
            self.connection.execute(begin)
            try:
                # A restore puts another file in this place: what is written here would be lost.
                try:
                    found = self._path.stat()
                except OSError:
                    found = None
                if found is None or (found.st_dev, found.st_ino) != self._file:
                    raise StoreError(
                        f"{self._path} was replaced by another command, nothing was changed",
                        "run the command again: it then uses the new record",
                    )
                yield self.connection
                self.connection.execute(commit)
            except BaseException:
                if self.connection.in_transaction:  # a full disk ends the transaction
                    for statement in rollback:
                        self.connection.execute(statement)
                raise

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


def _connect(path: Path) -> sqlite3.Connection:
    with _faults(path):
        return sqlite3.connect(
            f"{path.absolute().as_uri()}?mode=rw", timeout=BUSY_TIMEOUT, isolation_level=None, uri=True
        )


def _configure(db: sqlite3.Connection) -> None:
    # FULL: what was signed is on the disk before it is given out. No schema is trusted: a function in it
    # would run here with the rights of the authority.
    for pragma in ("journal_mode = WAL", "synchronous = FULL", "trusted_schema = OFF"):
        db.execute(f"PRAGMA {pragma}")
