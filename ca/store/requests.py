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
from ca.store.lifecycle import (
    COLLECTED_AFTER,
    JOINING,
    KEPT_EXPIRED,
    MAX_JOINING,
    MAX_OPEN,
    OPEN,
    RETENTION,
    RequestRow,
    RequestState,
    advance,
)
from ca.store.log import COLLECTED
from ca.store.schema import append_entry

_COLUMNS = (
    "digest, name, thumbprint, der, source, arrived, state, reason, changed, replaces, wildcard"
)

_OPEN = ", ".join(f"'{state}'" for state in sorted(OPEN))
_RETENTION = " ".join(f"WHEN '{state}' THEN {kept}" for state, kept in RETENTION.items())
# A row in an unknown state is read, and refused: it must not be taken for an expired one.
_EXPIRES = f"changed + CASE state {_RETENTION} ELSE {1 << 53} END"


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
            if stored is not None and now <= stored.expires:
                return stored
            self._check_new(request, source, now)
            if stored is not None:  # it expired, and is asked anew
                _delete(db, stored, now)
            row = RequestRow(
                request.digest, request.name, request.thumbprint, der, source, now,
                RequestState.PENDING, "", now,
            )  # fmt: skip
            db.execute("INSERT INTO csr VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)", row)
            append_entry(db, now, RequestState.PENDING, row.name, source, row.digest)
        return row

    def all(self, now: int = 0) -> list[RequestRow]:
        """Every request that has not expired at `now` (0: expired ones too), oldest first."""
        return self._rows(f"WHERE {_EXPIRES} >= ? ORDER BY arrived, rowid", now)

    def open(self, now: int = 0) -> list[RequestRow]:
        """Those that wait for an answer or their identity; at `now` without expired ones."""
        return self._rows(f"WHERE state IN ({_OPEN}) AND {_EXPIRES} >= ?", now)

    def find(self, digest: bytes) -> RequestRow | None:
        """The request with this digest, if it is recorded."""
        return next(iter(self._rows("WHERE digest = ?", digest)), None)

    def get(self, digest: bytes) -> RequestRow:
        """One request, by its digest.

        Raises:
            StoreError: there is none.
        """
        return self.begun(digest.hex())

    def begun(self, beginning: str) -> RequestRow:
        """The one request whose digest begins so, in hexadecimal digits.

        Raises:
            StoreError: there is none, or more than one.
        """
        begins = "WHERE substr(lower(hex(digest)), 1, ?) = ?"
        found = self._rows(begins, len(beginning), beginning.lower())
        if len(found) != 1 or not beginning:
            raise StoreError(
                f"{len(found)} requests begin with {beginning!a}", "see: rossec ca requests"
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
        """Delete what expired long ago and many came after; returns the deleted ones.

        A clock that is ahead for one look would else delete what comes back when it is right: so
        the newest `KEPT_EXPIRED` stay, whatever the clock says, and count nowhere.
        """
        if not self._collectable(now):  # without the lock of a transaction
            return []
        with self._database.transaction() as db:
            over = self._collectable(now)
            for row in over:
                _delete(db, row, now)
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

    def _collectable(self, now: int) -> list[RequestRow]:
        """All but the newest of those that expired, if they did so `COLLECTED_AFTER` ago."""
        newest_first = f"WHERE {_EXPIRES} < ? ORDER BY changed DESC, rowid DESC LIMIT -1 OFFSET ?"
        return self._rows(newest_first, now - COLLECTED_AFTER, KEPT_EXPIRED)

    def _check_name(
        self, row: RequestRow, now: int, replace_key: str | None, *, wildcard: bool
    ) -> None:
        """Return if the key of the request may have the name, as for `approve`."""
        for other in self.open(now):
            if other.name == row.name and other.thumbprint != row.thumbprint:
                raise NameContested(
                    f"two different keys request the name {row.name}",
                    f"compare fingerprints, then deny the other: rossec ca deny {_short(other)}",
                )
        self._identities.check_names(
            row.name, row.thumbprint, now, lambda other: covers(row.name, other, wildcard=wildcard)
        )
        self._identities.check_key(row.name, row.thumbprint, now, replace_key=replace_key)

    def _check_new(self, request: IdentityRequest, source: str, now: int) -> None:
        if self._identities.issued_for(request.digest) is not None:
            raise RequestClosed(
                f"this request of {request.name} has its certificate already",
                f"see: rossec ca show {request.name}; for another: rossec ca renew {request.name}",
            )
        waiting = self.open(now)
        joining = sum(row.source.startswith(JOINING) for row in waiting)
        full = source.startswith(JOINING) and joining >= MAX_JOINING
        if full or len(waiting) >= MAX_OPEN:
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


def _delete(db: sqlite3.Connection, row: RequestRow, now: int) -> None:
    db.execute("DELETE FROM csr WHERE digest = ?", (row.digest,))
    append_entry(db, now, COLLECTED, row.name, row.state, row.digest)


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
