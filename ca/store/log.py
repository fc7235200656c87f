"""The log in the authority's record, its audit, and what persons approved: passkeys and approvals.

A passkey that has ended never comes back. A statement is approved once, by a passkey that was active
then, and names a true head of this log from after the last restore. An approval waits until one
entry says how it ended.
"""

from collections.abc import Callable, Iterable, Mapping
from enum import StrEnum
from itertools import zip_longest
from typing import Any, Final, NamedTuple

from ca.approvals.passkeys import Approval, ApprovalVerifier, AuthenticatorData, Passkey, to_approve
from ca.approvals.statement import Statement, StatementKind
from ca.domains import verify_domains
from ca.errors import ApprovalOver, ApprovalRefused, CAError, LogDamaged, StoreError
from ca.keys.signing import PublicKey
from ca.revocation.merkle import Tree, root_of
from ca.store import database
from ca.store.database import Database, append_entry
from ca.store.signed_statements import DomainRow, ThingRow, check_domains_apart, check_things_apart
from ca.store.values import (
    REPLAY_HINT,
    TRANSITIONS,
    Head,
    LogEntry,
    RequestState,
    check_entries,
    check_head,
    digest_of,
    leaf,
    open_head,
    split_peaks,
)
from ca.things import ThingStatement, peek_statement, verify_statement

RESTORED: Final = "restored"
Row = tuple[Any, ...]

COLLECTED: Final = "collected"
# Kinds of entries whose rows say more than the entry: they are read again with it.
REPLAYED: Final = (
    *("passkey", "passkey ended", "approval", "approval ended"),
    *("domain", "domain ended", "domain list", "thing"),
)
_AGAIN = "look at the page again, and approve that"


class Replay:
    """Does again what the log says, entry by entry: what could not have been done was not done.

    `rows` are those beside the entries, by kind: a row of each entry, as the audit has compared before.
    """

    def __init__(self, rows: Mapping[str, Iterable[Row]], tree: Tree, key: PublicKey) -> None:
        self.states: dict[bytes, RequestState] = {}  # of the requests that were not collected
        self._rows = {what: iter(found) for what, found in rows.items()}
        self._tree = tree
        self._key = key
        self._passkeys: set[bytes] = set()  # the active ones
        self._verifier = ApprovalVerifier(())
        self._approved: dict[bytes, Statement] = {}
        self._waiting: set[bytes] = set()
        self._restored = -1
        self._domains: dict[str, DomainRow] = {}  # the trusted ones
        self._list = (0, 0)  # number of the last list of them
        self._things: dict[str, ThingStatement] = {}  # those in force, by their id

        self._steps: dict[str, Callable[[LogEntry, Row], object]] = {
            **dict.fromkeys(RequestState, self._move_request),
            COLLECTED: lambda entry, _: self.states.pop(entry.digest, None),
            RESTORED: self._restore,
            "passkey": self._add_passkey,
            "passkey ended": self._end_passkey,
            "approval": self._approve,
            "approval ended": self._end_approval,
            "domain": self._accept_domain,
            "domain ended": self._end_domain,
            "domain list": self._list_domains,
            "thing": self._state_thing,
            "revocation": lambda entry, _: self._things.pop(entry.subject, None),
        }

    def take(self, entry: LogEntry) -> None:
        step = self._steps.get(entry.what)
        if step is None:
            return
        try:
            step(entry, next(self._rows[entry.what]) if entry.what in self._rows else ())
        except LogDamaged:
            raise
        except CAError as error:
            raise LogDamaged(f"log entry {entry.number}: {error}", REPLAY_HINT) from error

    def _move_request(self, entry: LogEntry, _: Row) -> None:
        state, current = RequestState(entry.what), self.states.get(entry.digest)
        if not (state is RequestState.PENDING if current is None else state in TRANSITIONS[current]):
            raise LogDamaged(
                f"log entry {entry.number} is not an allowed transition of a request", REPLAY_HINT
            )
        self.states[entry.digest] = state

    def _restore(self, entry: LogEntry, _: Row) -> None:
        self._restored = entry.number

    def _add_passkey(self, entry: LogEntry, row: Row) -> None:
        passkey = Passkey(*row)
        if passkey.approval:  # by another phone; without one it was added at the terminal
            by = self._approved.get(passkey.approval)
            _require(by is not None and by.what == to_approve(passkey), entry)
        self._passkeys.add(passkey.id)
        self._verifier.add_passkey(passkey)

    def _end_passkey(self, entry: LogEntry, row: Row) -> None:
        _require(row[0] in self._passkeys, entry)  # a phone ends once, and never comes back
        self._passkeys.discard(row[0])

    def _approve(self, entry: LogEntry, row: Row) -> None:
        approval = Approval(*row)
        _require(approval.passkey in self._passkeys, entry)
        statement = self._verifier.verify(approval)
        # What a person saw was this log: a head of it, from after the last restore.
        _require(self._restored < statement.log_size <= entry.number, entry)
        _require(self._tree.root(statement.log_size) == statement.log_root, entry)
        self._approved[approval.id] = statement
        self._waiting.add(approval.id)

    def _end_approval(self, entry: LogEntry, row: Row) -> None:
        _require(row[0] in self._waiting, entry)
        self._waiting.discard(row[0])

    def _accept_domain(self, entry: LogEntry, found_row: Row) -> None:
        row = DomainRow(*found_row)
        terms = row.read()
        found = terms.domain, terms.label, terms.anchor.thumbprint
        _require(found == (row.domain, row.label, row.root), entry)
        for known in self._domains.values():
            check_domains_apart(known, *found)
        self._domains[row.domain] = row

    def _end_domain(self, entry: LogEntry, row: Row) -> None:
        ended = [each.domain for each in self._domains.values() if each.number == row[0]]
        _require(len(ended) == 1, entry)
        del self._domains[ended[0]]

    def _list_domains(self, entry: LogEntry, row: Row) -> None:
        epoch, seq, data = row
        # Each list has the terms that were accepted then, and a number above that of the one before.
        listed = verify_domains(data, self._key)
        _require(self._list < (epoch, seq) == listed.number, entry)
        self._list = listed.number
        for each in listed.domains:
            known = self._domains.get(each.domain)
            _require(known is not None and known.terms == each.terms, entry)

    def _state_thing(self, entry: LogEntry, found_row: Row) -> None:
        row = ThingRow(*found_row)
        found = verify_statement(row.data, self._key, domain=peek_statement(row.data).domain)
        # The columns are what commands look things up by: they say what was signed.
        said = (found.id, found.name, found.not_before, found.expires)
        _require(said == (row.id, row.name, row.not_before, row.expires), entry)
        self._things = {key: known for key, known in self._things.items() if known.expires > entry.at}
        for known in self._things.values():
            check_things_apart(known, found)
        self._things[row.id.hex()] = found


def _require(holds: bool, entry: LogEntry) -> None:
    if not holds:
        raise LogDamaged(f"log entry {entry.number} says {entry.what}, which cannot be", REPLAY_HINT)


class AuthorityLog:
    def __init__(self, database: Database) -> None:
        self._database = database

    def entries(self) -> list[LogEntry]:
        return self._find("ORDER BY number")

    def newest(self, count: int, before: int | None = None) -> list[LogEntry]:
        clause, values = ("", ()) if before is None else ("WHERE number < ?", (before,))
        return self._find(f"{clause} ORDER BY number DESC LIMIT ?", *values, count)

    def _find(self, clause: str, *values: object) -> list[LogEntry]:
        query = f"SELECT number, at, what, subject, detail, digest FROM log {clause}"  # noqa: S608  (constants)
        return [LogEntry(*row) for row in self._database.rows(query, *values)]

    def head(self, now: int) -> Head:
        rows = self._database.rows("SELECT number, peaks FROM log ORDER BY number DESC LIMIT 1")
        size, peaks = (rows[0][0] + 1, rows[0][1]) if rows else (0, b"")
        return Head(size, root_of(split_peaks(peaks)), now)

    def root_at(self, size: int) -> bytes | None:
        # The root of the first `size` entries; None if there are not so many.
        if size == 0:
            return root_of(())
        rows = self._database.rows("SELECT peaks FROM log WHERE number = ?", size - 1)
        return root_of(split_peaks(rows[0][0])) if rows else None

    def subjects(self, what: str) -> frozenset[str]:
        rows = self._database.rows("SELECT DISTINCT subject FROM log WHERE what = ?", what)
        return frozenset(subject for (subject,) in rows)

    def last_restore(self) -> int:
        query = "SELECT number FROM log WHERE what = ? ORDER BY number DESC LIMIT 1"
        rows = self._database.rows(query, RESTORED)
        return int(rows[0][0]) if rows else -1

    def add_head(self, data: bytes, now: int) -> None:
        with self._database.transaction() as db:
            db.execute("INSERT INTO head VALUES (?, ?) ON CONFLICT DO NOTHING", (data, now))

    def heads(self) -> list[bytes]:
        rows = self._database.rows("SELECT data FROM head ORDER BY rowid")
        return [bytes(data) for (data,) in rows]

    def tree(self) -> Tree:
        return Tree(map(leaf, self.entries()))

    def audit(self, key: PublicKey, *more: bytes) -> Head:
        # `key` is the authority's; `more` are heads stored elsewhere.
        with self._database.read_transaction():  # another command may be writing
            # 1. No stored hash is trusted: the tree is computed, and no entry differs from it.
            query = "SELECT number, at, what, subject, detail, digest, peaks FROM log ORDER BY number"
            stored = [(LogEntry(*row[:-1]), row[-1]) for row in self._database.rows(query)]
            tree, entries = check_entries(stored), [entry for entry, _ in stored]
            # 2. Every row has its entry, and the other way round.
            for what in database.LOGGED_TABLES:
                of_kind = [each for each in entries if each.what == what]
                for row, entry in zip_longest(self._database.logged(what), of_kind):
                    if entry is None:
                        raise LogDamaged(f"a {what} is recorded that is not in the log", REPLAY_HINT)
                    if row is None or digest_of(row) != entry.digest:
                        raise LogDamaged(
                            f"the {what} of log entry {entry.number} is missing or was changed", REPLAY_HINT
                        )
            # 3. What was done one after the other was allowed.
            done = Replay({what: self._database.logged(what) for what in REPLAYED}, tree, key)
            for entry in entries:
                done.take(entry)
            requests = self._database.rows("SELECT digest, state FROM csr")
            if {bytes(digest): RequestState(state) for digest, state in requests} != done.states:
                raise LogDamaged("the states of the requests differ from the log", REPLAY_HINT)
            # 4. Each signed head is of this tree.
            newest = Head(0, root_of(()), 0)
            for data in (*self.heads(), *more):
                head = open_head(data, key)
                check_head(tree, head)
                newest = max(newest, head, key=lambda each: each.size)
            return newest


class PasskeyTable:
    def __init__(self, database: Database) -> None:
        self._database = database

    def add(self, passkey: Passkey) -> None:
        with self._database.transaction() as db:
            # A person names the phone that is to be removed: two of one name would be a trap.
            if any(known.name == passkey.name for known in self.active()):
                raise StoreError(
                    f"there is a passkey called {passkey.name!a}",
                    "choose another name, or remove that one: rossec console phones remove NAME",
                )
            db.execute("INSERT INTO passkey VALUES (?, ?, ?, ?, ?, ?, ?, ?)", passkey)
            append_entry(db, passkey.at, "passkey", passkey.name, passkey.id.hex(), digest_of(passkey))

    def all(self) -> list[Passkey]:
        return self._rows("ORDER BY rowid")

    def active(self) -> list[Passkey]:
        return self._rows("WHERE id NOT IN (SELECT passkey FROM passkey_end) ORDER BY rowid")

    def get(self, id: bytes) -> Passkey:  # noqa: A002 - as in the row
        for passkey in self.active():
            if passkey.id == id:
                return passkey
        raise ApprovalRefused(
            "this passkey is not registered here, or was removed", "register the phone: rossec console phone"
        )

    def ended(self) -> dict[bytes, str]:
        return dict(self._database.rows("SELECT passkey, reason FROM passkey_end"))

    def end(self, id: bytes, reason: str, now: int) -> None:  # noqa: A002 - as in the row
        with self._database.transaction() as db:
            passkey, row = self.get(id), (id, reason, now)
            db.execute("INSERT INTO passkey_end VALUES (?, ?, ?)", row)
            append_entry(db, now, "passkey ended", passkey.name, reason, digest_of(row))

    def end_all(self, reason: str, now: int) -> int:
        with self._database.transaction():
            active = self.active()
            for passkey in active:
                self.end(passkey.id, reason, now)
        return len(active)

    def _rows(self, clause: str) -> list[Passkey]:
        return [Passkey(*row) for row in self._database.logged("passkey", clause)]


class ApprovalState(StrEnum):
    """What became of an approval; it waits until an `ApprovalEnd` says otherwise."""

    WAITING = "waiting"
    DONE = "done"
    FAILED = "failed"
    EXPIRED = "expired"


class ApprovalEnd(NamedTuple):
    approval: bytes
    state: str
    result: str
    at: int


class ApprovalTable:
    def __init__(self, database: Database, passkeys: PasskeyTable, log: AuthorityLog) -> None:
        self._database = database
        self._passkeys = passkeys
        self._log = log

    def add(self, approval: Approval, counter: int = 0) -> Statement:
        # `counter` is the largest of the passkey that is known besides the recorded ones, as from a login. To
        # be called inside the transaction that carries it out, if it is carried out now.
        with self._database.transaction() as db:
            passkey = self._passkeys.get(approval.passkey)
            last = max(counter, self.counter(passkey.id))
            statement = ApprovalVerifier([passkey], [(passkey.id, last)]).verify(approval)
            # What was shown before a restore says nothing about the record as it is now.
            size, restored = statement.log_size, self._log.last_restore()
            if self._log.root_at(size) != statement.log_root or size <= restored:
                raise ApprovalRefused("the record was restored or replaced since it was shown", _AGAIN)
            # In the same transaction: of two browsers with one statement one is refused.
            if self._rows("WHERE id = ?", approval.id):
                raise ApprovalRefused("this was approved already", _AGAIN)
            db.execute("INSERT INTO approval VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)", approval)
            detail = f"{StatementKind(approval.kind).name.lower()} {approval.id.hex()}"
            append_entry(db, approval.at, "approval", passkey.name, detail, digest_of(approval))
        return statement

    def get(self, id: bytes) -> Approval:  # noqa: A002 - as in the row
        found = self._rows("WHERE id = ?", id)
        if not found:
            raise ApprovalOver("there is no such approval", "see: rossec console approvals")
        return found[0]

    def all(self) -> list[Approval]:
        return self._rows("ORDER BY rowid")

    def newest(self, count: int) -> list[Approval]:
        return self._rows("ORDER BY rowid DESC LIMIT ?", count)

    def last_used(self) -> dict[bytes, int]:
        return dict(self._database.rows("SELECT passkey, max(at) FROM approval GROUP BY passkey"))

    def approvers(self, kind: StatementKind) -> dict[bytes, bytes]:
        query = "SELECT id, passkey FROM approval WHERE kind = ?"
        return dict(self._database.rows(query, int(kind)))

    def about(self, kind: StatementKind, subject: bytes) -> list[Approval]:
        return self._rows("WHERE kind = ? AND subject = ? ORDER BY rowid", int(kind), subject)

    def waiting(self) -> list[Approval]:
        return self._rows("WHERE id NOT IN (SELECT approval FROM approval_end) ORDER BY rowid")

    def ends(self) -> dict[bytes, ApprovalEnd]:
        # How approvals ended, by their id; those that wait are not in it.
        return {row[0]: ApprovalEnd(*row) for row in self._database.logged("approval ended")}

    def state(self, id: bytes) -> ApprovalState:  # noqa: A002 - as in the row
        query = "SELECT state FROM approval_end WHERE approval = ?"
        rows = self._database.rows(query, self.get(id).id)
        return ApprovalState(rows[0][0]) if rows else ApprovalState.WAITING

    def end(self, id: bytes, state: ApprovalState, result: str, now: int) -> None:  # noqa: A002
        if state is ApprovalState.WAITING:
            raise ValueError("waiting is not an end")
        with self._database.transaction() as db:
            if (found := self.state(id)) is not ApprovalState.WAITING:
                raise ApprovalOver(f"this approval has ended: {found}", "see: rossec console approvals")
            row = ApprovalEnd(id, str(state), result, now)
            db.execute("INSERT INTO approval_end VALUES (?, ?, ?, ?)", row)
            append_entry(db, now, "approval ended", id.hex(), f"{state}: {result}", digest_of(row))

    def end_waiting(self, reason: str, now: int) -> int:
        with self._database.transaction():
            waiting = self.waiting()
            for approval in waiting:
                self.end(approval.id, ApprovalState.FAILED, reason, now)
        return len(waiting)

    def counter(self, passkey: bytes) -> int:
        rows = self._database.rows(
            "SELECT authenticator_data FROM approval WHERE passkey = ? ORDER BY rowid DESC LIMIT 1", passkey
        )
        return AuthenticatorData.read(rows[0][0]).counter if rows else 0

    def _rows(self, clause: str, *values: object) -> list[Approval]:
        return [Approval(*row) for row in self._database.logged("approval", clause, *values)]
