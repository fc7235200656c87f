"""The tables and triggers of the authority's record; `ca.store.migration` brings older ones up.

All but requests for identities are append-only: triggers refuse every change. Such a request
follows `ca.store.lifecycle.TRANSITIONS` and is deleted at its end; triggers made from that table
refuse every other transition. Every table in `LOGGED_TABLES` has its rows in the log. All
functions run inside the caller's transaction.
"""

import re
import sqlite3
from collections.abc import Iterator
from typing import Final

from ca.errors import StoreError
from ca.store.lifecycle import TRANSITIONS, RequestState
from ca.store.log_entries import LogEntry, extend_peaks

APPLICATION_ID: Final = 0x524F5343  # "ROSC"
VERSION: Final = 6
_RESTORE_HINT: Final = "restore a backup of your own, and find out who made this one"
APPEND_ONLY: Final = ("certificate", "grant_", "revocation", "list", "head", "log")  # of version 1
ANSWERS: Final = "answer"  # of version 2, and append-only as well
DECISIONS: Final = (  # of version 3, all append-only
    "grant_request", "decision", "policy_grant", "invitation", "invitation_use", "invitation_end",
)  # fmt: skip
APPROVALS: Final = (  # of version 4, all append-only
    "passkey", "passkey_end", "approval", "approval_end",
)  # fmt: skip
DOMAINS: Final = (  # of version 5, all append-only
    "foreign_domain", "foreign_domain_end", "domain_list", "foreign_certificate",
)  # fmt: skip
THINGS: Final = ("thing",)  # of version 6, append-only
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

VERSION_1: Final = (  # unchanged since version 1
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
VERSION_2: Final = (
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
VERSION_3: Final = (
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
)
VERSION_4: Final = (
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
)
VERSION_5: Final = (
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
)
VERSION_6: Final = (
    # Statements about constrained things; `border` is the name of the router that serves it.
    """CREATE TABLE thing (
        id BLOB PRIMARY KEY, name TEXT NOT NULL, border TEXT NOT NULL, data BLOB NOT NULL,
        not_before INTEGER NOT NULL, expires INTEGER NOT NULL, at INTEGER NOT NULL
    ) STRICT""",
)
_TABLES: Final = (*VERSION_1, *VERSION_2, *VERSION_3, *VERSION_4, *VERSION_5, *VERSION_6)
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
    append_only = (*APPEND_ONLY, ANSWERS, *DECISIONS, *APPROVALS, *DOMAINS, *THINGS)
    for statement in (*_TABLES, *append_only_triggers(append_only)):
        db.execute(statement)
    for statement in request_triggers():
        db.execute(statement)
    db.execute(f"PRAGMA application_id = {APPLICATION_ID}")
    db.execute(f"PRAGMA user_version = {VERSION}")


def check_no_foreign_objects(db: sqlite3.Connection) -> None:
    """Return if this file has no other tables, triggers and views than those created here.

    A trigger could drop an inserted row, a view or a virtual table could replace a table.

    Raises:
        StoreError: names the first object that is foreign, missing or changed.
    """
    expected_db = sqlite3.connect(":memory:")
    create(expected_db)
    expected, found = _objects(expected_db), _objects(db)
    expected_db.close()
    for name, created in found.items():
        if expected.get(name) != created:
            raise StoreError(
                f"the record holds a {created[0]} that is not rossec's: {name!a}", _RESTORE_HINT
            )
    if missing := expected.keys() - found.keys():
        raise StoreError(f"the record lacks {min(missing)}", _RESTORE_HINT)


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
    for statement in _TABLES:
        kind, name = statement.split()[1:3]
        if kind == "TABLE" and found.get(name) != _normal(statement):
            raise StoreError(
                f"the table {name} of the record differs from rossec's schema",
                "restore it from a backup of your own, and find out who changed it",
            )


def _normal(statement: str) -> str:
    return " ".join(statement.split())


def append_entry(
    db: sqlite3.Connection, at: int, what: str, subject: str, detail: str, digest: bytes
) -> None:
    """Append an entry to the log, inside the transaction of the change it describes."""
    last = db.execute("SELECT number, peaks FROM log ORDER BY number DESC LIMIT 1").fetchone()
    number, peaks = (0, b"") if last is None else (last[0] + 1, last[1])
    entry = LogEntry(number, at, what, subject, detail, digest)
    db.execute("INSERT INTO log VALUES (?, ?, ?, ?, ?, ?, ?)", (*entry, extend_peaks(peaks, entry)))


def append_only_triggers(tables: tuple[str, ...]) -> Iterator[str]:
    """The triggers that refuse every change of `tables`."""
    for table in tables:
        for verb in ("UPDATE", "DELETE"):
            yield _NO_CHANGE.format(table=table, verb=verb)


def request_triggers() -> tuple[str, str, str]:
    """The triggers of requests for identities, from `TRANSITIONS`."""
    transitions = ", ".join(
        f"'{old}>{new}'" for old, following in TRANSITIONS.items() for new in sorted(following)
    )
    return _NEW_REQUEST, _REQUEST_IMMUTABLE, _REQUEST_TRANSITIONS.format(allowed=transitions)
