"""The requests for identities in the authority's record: pending, approved, denied, issued.

It applies `ca.store.lifecycle`. A name has one owner: approving a key for a name that has a valid
identity with another key needs the name again (`replace_key`), and of two keys that request one
name at the same time neither is approved until the other is denied.
"""

import sqlite3

from ca.errors import NameContested, RequestClosed, StoreError, TooManyRequests
from ca.names import covers
from ca.requests import IdentityRequest
from ca.store.database import Database
from ca.store.identities import IdentityTable
from ca.store.lifecycle import MAX_OPEN, OPEN, RETENTION, RequestRow, RequestState, advance
from ca.store.log import COLLECTED
from ca.store.schema import append_entry

_COLUMNS = (
    "digest, name, thumbprint, der, source, arrived, state, reason, changed, replaces, wildcard"
)

_OPEN = ", ".join(f"'{state}'" for state in sorted(OPEN))
_RETENTION = " ".join(f"WHEN '{state}' THEN {kept}" for state, kept in RETENTION.items())


class RequestTable:
    """The table of requests."""

    def __init__(self, database: Database, identities: IdentityTable) -> None:
        self._database = database
        self._identities = identities

    def add(self, request: IdentityRequest, der: bytes, source: str, now: int) -> RequestRow:
        """Record a verified request as pending; an already recorded one is returned unchanged.

        `source` is where it came from, for the approver.

        Raises:
            RequestClosed: too many are open, or it got its certificate and was deleted since.
        """
        self.collect(now)
        with self._database.transaction() as db:
            stored = self.find(request.digest)
            if stored is not None:
                return stored
            self._check_new(request)
            row = RequestRow(
                request.digest, request.name, request.thumbprint, der, source, now,
                RequestState.PENDING, "", now,
            )  # fmt: skip
            db.execute("INSERT INTO csr VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)", row)
            append_entry(db, now, RequestState.PENDING, row.name, source, row.digest)
        return row

    def all(self) -> list[RequestRow]:
        """Every request that is not collected, oldest first."""
        return self._rows("ORDER BY arrived, rowid")

    def open(self) -> list[RequestRow]:
        """Those that wait for an answer, or for their identity."""
        return self._rows(f"WHERE state IN ({_OPEN})")

    def find(self, digest: bytes) -> RequestRow | None:
        """The request with this digest, if it is recorded."""
        return next(iter(self._rows("WHERE digest = ?", digest)), None)

    def get(self, digest: bytes) -> RequestRow:
        """One request, by its digest or a prefix of it.

        Raises:
            StoreError: there is none, or more than one.
        """
        found = self._rows("WHERE substr(digest, 1, ?) = ?", len(digest), digest)
        if len(found) != 1 or not digest:
            raise StoreError(
                f"{len(found)} requests begin with {digest.hex()}", "see: rossec ca requests"
            )
        return found[0]

    def approve(
        self,
        digest: bytes,
        now: int,
        reason: str = "",
        *,
        replace_key: str | None = None,
        wildcard: bool = False,
    ) -> RequestRow:
        """Approve a request. `replace_key` is the name again, when it has another key.

        `wildcard`: the identity shall cover anonymous nodes too, whatever the request says.

        Raises:
            RequestClosed: it is not pending, or has expired.
            NameCovered: two keys would share a name.
            KeyChanged, NameContested: the name has another key, or another key requests it.
        """
        with self._database.transaction():
            row = self.get(digest)
            self._check_name(row, now, replace_key, wildcard=wildcard)
            approved = row._replace(replaces=replace_key is not None, wildcard=wildcard)
            return self._advance(approved, RequestState.APPROVED, now, reason)

    def deny(self, digest: bytes, now: int, reason: str = "") -> RequestRow:
        """Deny a request, also an approved one that is not issued yet.

        Raises:
            RequestClosed: it was issued, or denied before.
        """
        with self._database.transaction():
            return self._advance(self.get(digest), RequestState.DENIED, now, reason)

    def collect(self, now: int) -> list[RequestRow]:
        """Delete every expired request; returns the deleted ones."""
        if not self._expired(now):  # without the lock of a transaction
            return []
        with self._database.transaction() as db:
            over = self._expired(now)
            for row in over:
                db.execute("DELETE FROM csr WHERE digest = ?", (row.digest,))
                append_entry(db, now, COLLECTED, row.name, row.state, row.digest)
        return over

    def mark_issued(self, db: sqlite3.Connection, digest: bytes, now: int) -> None:
        """Mark as issued, inside the transaction that records the certificate.

        Raises:
            RequestClosed: it was not approved.
        """
        stored = self.find(digest)
        if stored is None:
            raise RequestClosed(
                "the request is not recorded", "first: rossec ca approve REQUEST_ID"
            )
        _update(db, advance(stored, RequestState.ISSUED, now))

    def _expired(self, now: int) -> list[RequestRow]:
        return self._rows(f"WHERE changed + CASE state {_RETENTION} END < ?", now)

    def _check_name(
        self, row: RequestRow, now: int, replace_key: str | None, *, wildcard: bool
    ) -> None:
        """Return if the key of the request may have the name, as for `approve`."""
        for other in self.open():
            if other.name == row.name and other.thumbprint != row.thumbprint:
                raise NameContested(
                    f"two different keys request the name {row.name}",
                    f"compare fingerprints, then deny the other: rossec ca deny {_short(other)}",
                )
        self._identities.check_names(
            row.name, row.thumbprint, now, lambda other: covers(row.name, other, wildcard=wildcard)
        )
        self._identities.check_key(row.name, row.thumbprint, now, replace_key=replace_key)

    def _check_new(self, request: IdentityRequest) -> None:
        if self._identities.issued_for(request.digest) is not None:
            raise RequestClosed(
                f"this request of {request.name} has its certificate already",
                f"see: rossec ca show {request.name}; for another: rossec ca renew {request.name}",
            )
        if len(self.open()) >= MAX_OPEN:
            raise TooManyRequests(
                f"{MAX_OPEN} requests are pending, the maximum",
                "list them with: rossec ca requests, and deny unknown ones",
            )

    def _advance(self, row: RequestRow, state: RequestState, now: int, reason: str) -> RequestRow:
        moved = advance(row, state, now, reason)
        with self._database.transaction() as db:
            _update(db, moved)
        return moved

    def _rows(self, clause: str, *values: object) -> list[RequestRow]:
        rows = self._database.rows(f"SELECT {_COLUMNS} FROM csr {clause}", *values)  # noqa: S608  (constants)
        return [
            RequestRow(*row)._replace(
                state=RequestState(row[6]), replaces=row[9] != 0, wildcard=row[10] != 0
            )
            for row in rows
        ]


def _update(db: sqlite3.Connection, row: RequestRow) -> None:
    """Triggers refuse other transitions, also when two commands run at once."""
    db.execute(
        "UPDATE csr SET state = ?, reason = ?, changed = ?, replaces = ?, wildcard = ?"
        " WHERE digest = ?",
        (row.state, row.reason, row.changed, row.replaces, row.wildcard, row.digest),
    )
    details = [
        row.reason,
        *["replaces the key"] * row.replaces,
        *["anonymous nodes"] * row.wildcard,
    ]
    append_entry(db, row.changed, row.state, row.name, "; ".join(filter(None, details)), row.digest)


def _short(row: RequestRow) -> str:
    return row.digest.hex()[:8]
