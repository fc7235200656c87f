"""The requests for identities in the authority's record: who asked, and who said yes or no.

A shell around `ca.store.lifecycle`. A name has one owner: approving a key for a name that lives
with another one needs the name spoken again (`replace_key`), and of two keys that ask for one name
at once neither is approved until the other is denied.
"""

import sqlite3

from ca.errors import NameContested, RequestClosed, StoreError
from ca.names import covers
from ca.requests import IdentityRequest
from ca.store.database import Database
from ca.store.identities import IdentityTable
from ca.store.lifecycle import MAX_OPEN, OPEN, RETENTION, RequestRow, RequestState, advance
from ca.store.log import COLLECTED, append_entry

_COLUMNS = (
    "digest, name, thumbprint, der, source, arrived, state, reason, changed, replaces, wildcard"
)

_OPEN = ", ".join(f"'{state}'" for state in sorted(OPEN))
_RETENTION = " ".join(f"WHEN '{state}' THEN {kept}" for state, kept in RETENTION.items())


class RequestTable:
    """The requests of one record."""

    def __init__(self, database: Database, identities: IdentityTable) -> None:
        self._database = database
        self._identities = identities

    def add(self, request: IdentityRequest, der: bytes, source: str, now: int) -> RequestRow:
        """Record a checked request as pending; one that is recorded already is returned as it is.

        `source` is where it came from, for the person who decides.

        Raises:
            RequestClosed: too many are open, or it got its certificate so long ago that the
                request itself is forgotten.
        """
        self.collect(now)
        with self._database.transaction() as db:
            held = self._find(request.digest)
            if held is not None:
                return held
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

    def get(self, digest: bytes) -> RequestRow:
        """One request, by the whole digest or the beginning of it.

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
        """Say yes. `replace_key` is the name again, when it lives with another key.

        `wildcard`: the identity is to stand for anonymous nodes too, whatever the request asks.

        Raises:
            RequestClosed: it is not pending, or its time is over.
            NameCovered: no two keys may go by one name.
            KeyChanged, NameContested: the name has another key, or somebody else asks for it.
        """
        with self._database.transaction():
            row = self.get(digest)
            self._check_name(row, now, replace_key, wildcard=wildcard)
            said = row._replace(replaces=replace_key is not None, wildcard=wildcard)
            return self._advance(said, RequestState.APPROVED, now, reason)

    def deny(self, digest: bytes, now: int, reason: str = "") -> RequestRow:
        """Say no, also to what was approved and not yet issued.

        Raises:
            RequestClosed: it was issued, or denied before.
        """
        with self._database.transaction():
            return self._advance(self.get(digest), RequestState.DENIED, now, reason)

    def collect(self, now: int) -> list[RequestRow]:
        """Forget every request whose time is over; returns what was forgotten."""
        if not self._expired(now):  # who only looks takes no lock
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
        held = self._find(digest)
        if held is None:
            raise RequestClosed("the request is not recorded", "first: rossec ca approve")
        _update(db, advance(held, RequestState.ISSUED, now))

    def _expired(self, now: int) -> list[RequestRow]:
        return self._rows(f"WHERE changed + CASE state {_RETENTION} END < ?", now)

    def _check_name(
        self, row: RequestRow, now: int, replace_key: str | None, *, wildcard: bool
    ) -> None:
        """Return if the key that asks may have the name, as `approve` says."""
        for other in self._open():
            if other.name == row.name and other.thumbprint != row.thumbprint:
                raise NameContested(
                    f"two different keys ask for the name {row.name}",
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
        if len(self._open()) >= MAX_OPEN:
            raise RequestClosed(
                f"{MAX_OPEN} requests wait for an answer and no more are taken",
                "look at them with: rossec ca requests, and deny what nobody knows",
            )

    def _advance(self, row: RequestRow, state: RequestState, now: int, reason: str) -> RequestRow:
        moved = advance(row, state, now, reason)
        with self._database.transaction() as db:
            _update(db, moved)
        return moved

    def _find(self, digest: bytes) -> RequestRow | None:
        return next(iter(self._rows("WHERE digest = ?", digest)), None)

    def _open(self) -> list[RequestRow]:
        return self._rows(f"WHERE state IN ({_OPEN})")

    def _rows(self, clause: str, *values: object) -> list[RequestRow]:
        rows = self._database.rows(f"SELECT {_COLUMNS} FROM csr {clause}", *values)  # noqa: S608  (constants)
        return [
            RequestRow(*row)._replace(
                state=RequestState(row[6]), replaces=row[9] != 0, wildcard=row[10] != 0
            )
            for row in rows
        ]


def _update(db: sqlite3.Connection, row: RequestRow) -> None:
    """The triggers of the record refuse a way that is not in the table, whoever was faster."""
    db.execute(
        "UPDATE csr SET state = ?, reason = ?, changed = ?, replaces = ?, wildcard = ?"
        " WHERE digest = ?",
        (row.state, row.reason, row.changed, row.replaces, row.wildcard, row.digest),
    )
    said = [row.reason, *["replaces the key"] * row.replaces, *["anonymous nodes"] * row.wildcard]
    append_entry(db, row.changed, row.state, row.name, "; ".join(filter(None, said)), row.digest)


def _short(row: RequestRow) -> str:
    return row.digest.hex()[:8]
