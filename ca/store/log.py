"""The log in the authority's record: written with every change, and audited as a whole.

`audit` trusts no stored hash: it computes the tree from the entries, compares every row of the
record with its log entry, replays the transitions of every request, the approvals of persons, the
foreign domains and the things, and checks each signed head.
"""

from itertools import zip_longest
from typing import Any, Final

from cryptography.hazmat.primitives.asymmetric import ec

from ca.errors import LogDamaged
from ca.revocation.merkle import Tree, root_of
from ca.store import schema
from ca.store.approval_replay import RESTORED, replay_approvals
from ca.store.database import Database
from ca.store.domain_replay import KINDS, replay_domains
from ca.store.lifecycle import TRANSITIONS, RequestState
from ca.store.log_entries import (
    Head,
    LogEntry,
    check_entries,
    check_head,
    digest_of,
    leaf,
    open_head,
    split_peaks,
)
from ca.store.thing_replay import KIND, replay_things

COLLECTED = "collected"
_OF_APPROVALS: Final = ("passkey", "passkey ended", "approval", "approval ended")
_HINT = "somebody changed the record: restore a backup, and find out who"


class AuthorityLog:
    """The log of one record."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def entries(self) -> list[LogEntry]:
        """All entries, oldest first."""
        rows = self._database.rows(
            "SELECT number, at, what, subject, detail, digest FROM log ORDER BY number"
        )
        return [LogEntry(*row) for row in rows]

    def newest(self, count: int, before: int | None = None) -> list[LogEntry]:
        """At most `count` entries, newest first; with `before`, older than that number."""
        clause, values = ("", ()) if before is None else ("WHERE number < ?", (before,))
        rows = self._database.rows(
            f"SELECT number, at, what, subject, detail, digest FROM log {clause}"  # noqa: S608  (constants)
            " ORDER BY number DESC LIMIT ?",
            *values, count,
        )  # fmt: skip
        return [LogEntry(*row) for row in rows]

    def head(self, now: int) -> Head:
        """The current head of the log, to be signed."""
        rows = self._database.rows("SELECT number, peaks FROM log ORDER BY number DESC LIMIT 1")
        size, peaks = (rows[0][0] + 1, rows[0][1]) if rows else (0, b"")
        return Head(size, root_of(split_peaks(peaks)), now)

    def root_at(self, size: int) -> bytes | None:
        """The root of the first `size` entries; None if there are not so many."""
        if size == 0:
            return root_of(())
        rows = self._database.rows("SELECT peaks FROM log WHERE number = ?", size - 1)
        return root_of(split_peaks(rows[0][0])) if rows else None

    def subjects(self, what: str) -> frozenset[str]:
        """The subjects of all entries of this kind."""
        rows = self._database.rows("SELECT DISTINCT subject FROM log WHERE what = ?", what)
        return frozenset(subject for (subject,) in rows)

    def last_restore(self) -> int:
        """The number of the entry about the last restore from a backup; -1: there was none."""
        query = "SELECT number FROM log WHERE what = ? ORDER BY number DESC LIMIT 1"
        rows = self._database.rows(query, RESTORED)
        return int(rows[0][0]) if rows else -1

    def add_head(self, data: bytes, now: int) -> None:
        """Store a signed head."""
        with self._database.transaction() as db:
            db.execute("INSERT INTO head VALUES (?, ?) ON CONFLICT DO NOTHING", (data, now))

    def heads(self) -> list[bytes]:
        """Every signed head, oldest first."""
        rows = self._database.rows("SELECT data FROM head ORDER BY rowid")
        return [bytes(data) for (data,) in rows]

    def tree(self) -> Tree:
        """The tree of all entries, for proofs."""
        return Tree(map(leaf, self.entries()))

    def audit(self, key: ec.EllipticCurvePublicKey, *more: bytes) -> Head:
        """Verify the whole log; returns the newest signed head.

        `key` is the authority's; `more` are heads stored elsewhere.

        Raises:
            LogDamaged: names the first difference.
        """
        with self._database.read_transaction():  # another command may be writing
            return self._audit(key, more)

    def _audit(self, key: ec.EllipticCurvePublicKey, more: tuple[bytes, ...]) -> Head:
        tree = check_entries(self._stored_entries())
        entries = self.entries()
        for what in schema.LOGGED_TABLES:
            self._check_rows(what, [entry for entry in entries if entry.what == what])
        self._check_requests(entries)
        replay_approvals(entries, {what: self._rows_of(what) for what in _OF_APPROVALS}, tree)
        replay_domains(entries, {what: self._rows_of(what) for what in KINDS}, key)
        replay_things(entries, self._rows_of(KIND), key)
        newest = Head(0, root_of(()), 0)
        for data in (*self.heads(), *more):
            head = open_head(data, key)
            check_head(tree, head)
            newest = max(newest, head, key=lambda each: each.size)
        return newest

    def _stored_entries(self) -> list[tuple[LogEntry, bytes]]:
        rows = self._database.rows(
            "SELECT number, at, what, subject, detail, digest, peaks FROM log ORDER BY number"
        )
        return [(LogEntry(*row[:-1]), row[-1]) for row in rows]

    def _check_rows(self, what: str, entries: list[LogEntry]) -> None:
        """Check that the rows of a table are those in the log, in the same order."""
        for row, entry in zip_longest(self._rows_of(what), entries):
            if entry is None:
                raise LogDamaged(f"a {what} is recorded that is not in the log", _HINT)
            if row is None or digest_of(row) != entry.digest:
                raise LogDamaged(
                    f"the {what} of log entry {entry.number} is missing or was changed", _HINT
                )

    def _rows_of(self, what: str) -> list[Any]:
        table, columns = schema.LOGGED_TABLES[what]
        return self._database.rows(f"SELECT {columns} FROM {table} ORDER BY rowid")  # noqa: S608  (constants)

    def _check_requests(self, entries: list[LogEntry]) -> None:
        """Check that every request took allowed transitions, and is in the state the log says."""
        states = _replay(entries)
        rows = self._database.rows("SELECT digest, state, der FROM csr")
        found = {bytes(digest): RequestState(state) for digest, state, _ in rows}
        if found != states:
            raise LogDamaged("the states of the requests differ from the log", _HINT)


def _replay(entries: list[LogEntry]) -> dict[bytes, RequestState]:
    """The states of all requests that were not collected, from the log."""
    states: dict[bytes, RequestState] = {}
    for entry in entries:
        current = states.get(entry.digest)
        if entry.what == COLLECTED and current is not None:
            del states[entry.digest]
        elif entry.what in _STATES:
            state = RequestState(entry.what)
            if not (
                state is RequestState.PENDING if current is None else state in TRANSITIONS[current]
            ):
                raise LogDamaged(
                    f"log entry {entry.number} is not an allowed transition of a request", _HINT
                )
            states[entry.digest] = state
    return states


_STATES = frozenset(RequestState)
