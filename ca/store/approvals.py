"""Approvals in the authority's record: what a person approved, and what came of it.

A statement is approved once: its id is the primary key. An approval waits until an entry says that
it was carried out, failed, or came to nothing. The statement names a head of this log, made since
the record was last restored: one from before says nothing about the record as it is now.
"""

from enum import StrEnum
from typing import NamedTuple

from ca.approvals.approval import Approval, ApprovalVerifier
from ca.approvals.assertion import counter_of
from ca.approvals.statement import Kind, Statement
from ca.errors import ApprovalOutdated, ApprovalOver, ApprovalUsed
from ca.store.database import Database
from ca.store.log import AuthorityLog
from ca.store.log_entries import digest_of
from ca.store.passkeys import PasskeyTable
from ca.store.schema import append_entry

_COLUMNS = (
    "id, kind, subject, statement, payload, passkey, client_data, authenticator_data, signature, at"
)
_AGAIN = "look at the page again, and approve that"


class ApprovalState(StrEnum):
    """What became of an approval; it waits until an `ApprovalEnd` says otherwise."""

    WAITING = "waiting"
    DONE = "done"
    FAILED = "failed"
    EXPIRED = "expired"


class ApprovalEnd(NamedTuple):
    """The end of an approval; `result` is one line about it."""

    approval: bytes
    state: str
    result: str
    at: int


class ApprovalTable:
    """The approvals of one record."""

    def __init__(self, database: Database, passkeys: PasskeyTable, log: AuthorityLog) -> None:
        self._database = database
        self._passkeys = passkeys
        self._log = log

    def add(self, approval: Approval, counter: int = 0) -> Statement:
        """Verify and record an approval; returns its statement.

        `counter` is the largest of the passkey that is known besides the recorded ones, as from a
        login. To be called inside the transaction that carries it out, if it is carried out now.

        Raises:
            ApprovalUsed: the statement was approved before.
            ApprovalOutdated: too late, or about a record that was restored or replaced since.
            PasskeyUnknown: the passkey is not registered, or has ended.
            ApprovalRefused: as `ca.approvals.approval.ApprovalVerifier`.
        """
        with self._database.transaction() as db:
            passkey = self._passkeys.get(approval.passkey)
            last = max(counter, self.counter(passkey.id))
            statement = ApprovalVerifier([passkey], [(passkey.id, last)]).verify(approval)
            self._check_log(statement)
            if self._rows("WHERE id = ?", approval.id):
                raise ApprovalUsed("this was approved already", _AGAIN)
            db.execute("INSERT INTO approval VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)", approval)
            detail = f"{Kind(approval.kind).name.lower()} {approval.id.hex()}"
            append_entry(db, approval.at, "approval", passkey.name, detail, digest_of(approval))
        return statement

    def get(self, id: bytes) -> Approval:  # noqa: A002 - as in the row
        """One approval.

        Raises:
            ApprovalOver: there is none.
        """
        found = self._rows("WHERE id = ?", id)
        if not found:
            raise ApprovalOver("there is no such approval", "see: rossec console approvals")
        return found[0]

    def all(self) -> list[Approval]:
        """Every approval, oldest first."""
        return self._rows("ORDER BY rowid")

    def newest(self, count: int) -> list[Approval]:
        """The `count` newest approvals, newest first."""
        return self._rows("ORDER BY rowid DESC LIMIT ?", count)

    def last_used(self) -> dict[bytes, int]:
        """When each passkey approved something last, by its credential id."""
        return dict(self._database.rows("SELECT passkey, max(at) FROM approval GROUP BY passkey"))

    def approvers(self, kind: Kind) -> dict[bytes, bytes]:
        """Which passkey approved, by the id of the approval; for one kind."""
        query = "SELECT id, passkey FROM approval WHERE kind = ?"
        return dict(self._database.rows(query, int(kind)))

    def about(self, kind: Kind, subject: bytes) -> list[Approval]:
        """The approvals of one kind about one thing, oldest first."""
        return self._rows("WHERE kind = ? AND subject = ? ORDER BY rowid", int(kind), subject)

    def waiting(self) -> list[Approval]:
        """The approvals that were neither carried out nor ended, oldest first."""
        return self._rows("WHERE id NOT IN (SELECT approval FROM approval_end) ORDER BY rowid")

    def ends(self) -> dict[bytes, ApprovalEnd]:
        """How approvals ended, by their id; those that wait are not in it."""
        rows = self._database.rows("SELECT approval, state, result, at FROM approval_end")
        return {row[0]: ApprovalEnd(*row) for row in rows}

    def state(self, id: bytes) -> ApprovalState:  # noqa: A002 - as in the row
        """What became of an approval.

        Raises:
            ApprovalOver: there is none.
        """
        query = "SELECT state FROM approval_end WHERE approval = ?"
        rows = self._database.rows(query, self.get(id).id)
        return ApprovalState(rows[0][0]) if rows else ApprovalState.WAITING

    def end(self, id: bytes, state: ApprovalState, result: str, now: int) -> None:  # noqa: A002
        """Record what became of an approval that waits.

        Raises:
            ApprovalOver: there is none, or it has ended.
        """
        if state is ApprovalState.WAITING:
            raise ValueError("waiting is not an end")
        with self._database.transaction() as db:
            if (found := self.state(id)) is not ApprovalState.WAITING:
                raise ApprovalOver(
                    f"this approval has ended: {found}", "see: rossec console approvals"
                )
            row = ApprovalEnd(id, str(state), result, now)
            db.execute("INSERT INTO approval_end VALUES (?, ?, ?, ?)", row)
            append_entry(db, now, "approval ended", id.hex(), f"{state}: {result}", digest_of(row))

    def end_waiting(self, reason: str, now: int) -> int:
        """End every approval that waits, without carrying it out; returns how many."""
        with self._database.transaction():
            waiting = self.waiting()
            for approval in waiting:
                self.end(approval.id, ApprovalState.FAILED, reason, now)
        return len(waiting)

    def counter(self, passkey: bytes) -> int:
        """The largest counter in the recorded assertions of a passkey; 0: none, or it has none."""
        rows = self._database.rows(
            "SELECT authenticator_data FROM approval WHERE passkey = ? ORDER BY rowid DESC LIMIT 1",
            passkey,
        )
        return counter_of(rows[0][0]) if rows else 0

    def _check_log(self, statement: Statement) -> None:
        size, restored = statement.log_size, self._log.last_restore()
        if self._log.root_at(size) != statement.log_root or size <= restored:
            raise ApprovalOutdated("the record was restored or replaced since it was shown", _AGAIN)

    def _rows(self, clause: str, *values: object) -> list[Approval]:
        rows = self._database.rows(f"SELECT {_COLUMNS} FROM approval {clause}", *values)  # noqa: S608  (constants)
        return [Approval(*row) for row in rows]
