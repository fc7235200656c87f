"""Identities in the authority's record, the requests for them, and the invitations by which nodes join.

A name keeps its key. Another key is accepted in three cases only: the name has no valid identity;
the operator gives the name again (`replace_key`); or the newest valid key itself signs the renewal
(`renews`). A use of an invitation is one identity for one new name.
"""

import hashlib
import json
import sqlite3
from collections.abc import Callable
from typing import NamedTuple

from ca import errors, svid
from ca.names import MASTER, covers, is_master_name
from ca.store.database import Database, append_entry
from ca.store.log import COLLECTED
from ca.store.values import (
    COLLECTED_AFTER,
    INTERMEDIATE,
    JOINING,
    KEPT_EXPIRED,
    MAX_JOINING,
    MAX_OPEN,
    OPEN,
    RETENTION,
    CertificateRow,
    RequestRow,
    RequestState,
    advance,
    digest_of,
)

_BEGINS = "(name >= ? AND name < ?)"  # by the index on names, where substr() reads every row

_REQUESTS_COLUMNS = (
    "digest, name, thumbprint, der, source, arrived, state, reason, changed, replaces, wildcard"
)

_OPEN = ", ".join(f"'{state}'" for state in sorted(OPEN))
_RETENTION = " ".join(f"WHEN '{state}' THEN {kept}" for state, kept in RETENTION.items())
# A row in an unknown state is read, and refused: it must not be taken for an expired one.
_EXPIRES = f"changed + CASE state {_RETENTION} ELSE {1 << 53} END"


_AGAIN = "make another: rossec ca invite PATTERN"


class IdentityTable:
    def __init__(self, database: Database) -> None:
        self._database = database

    def all(self) -> list[CertificateRow]:
        return self._find("ORDER BY rowid")

    def by_name(self, name: str) -> list[CertificateRow]:
        return self._find("WHERE name = ? ORDER BY rowid", name)

    def valid(self, name: str, now: int) -> list[CertificateRow]:
        # The valid identities of `name`: not expired, and no key of the chain is revoked.
        return self.with_valid_issuer(self.unrevoked(name, now))

    def all_valid(self, now: int) -> list[CertificateRow]:
        alive = "WHERE not_after >= ? AND thumbprint NOT IN (SELECT entry FROM revocation)"
        return self.with_valid_issuer(self._find(f"{alive} ORDER BY rowid", now))

    def valid_masters(self, now: int) -> list[CertificateRow]:
        found = self._find(
            f"WHERE (name = ? OR {_BEGINS}) AND not_after >= ?"  # noqa: S608  (constants)
            " AND thumbprint NOT IN (SELECT entry FROM revocation) ORDER BY rowid",
            MASTER,
            *_beginning(f"{MASTER}/"),
            now,
        )
        return self.with_valid_issuer([row for row in found if is_master_name(row.name)])

    def unrevoked(self, name: str, now: int) -> list[CertificateRow]:
        # Those not expired whose own key is not revoked: the ones that can still be revoked.
        return self._find(
            "WHERE name = ? AND not_after >= ?"
            " AND thumbprint NOT IN (SELECT entry FROM revocation) ORDER BY rowid",
            name,
            now,
        )

    def with_valid_issuer(self, rows: list[CertificateRow]) -> list[CertificateRow]:
        # Those of `rows` that were not signed by a revoked intermediate.
        ended = self._find(
            f"WHERE {_BEGINS} AND thumbprint IN (SELECT entry FROM revocation)",  # noqa: S608  (constants)
            *_beginning(INTERMEDIATE),
        )
        return [row for row in rows if _signer(row, ended) is None]

    def issuer(self, row: CertificateRow) -> CertificateRow | None:
        clause = f"WHERE {_BEGINS} ORDER BY rowid DESC"
        return _signer(row, self._find(clause, *_beginning(INTERMEDIATE)))

    def certified_name(self, name: str, now: int) -> str:
        # It is `name` itself or, for an anonymous node, that of the valid identity that covers it.
        covering = (row.name for row in self._related(name, now) if row.covers(name))
        return max(covering, key=len, default=name)

    def check_names(self, name: str, thumbprint: bytes, now: int, covers: Callable[[str], bool]) -> None:
        # Return if no two keys would share a name, also not through a wildcard tail.
        # `covers(other)`: whether the new identity would cover `other`.
        for known in self._related(name, now):
            overlap = known.covers(name) or covers(known.name)
            if known.thumbprint != thumbprint and known.name != name and overlap:
                raise errors.NameCovered(
                    f"{name} and {known.name}: one is for anonymous nodes and covers the other",
                    f"choose another name, or revoke {known.name} first",
                )

    def ever_shared(
        self, name: str, thumbprint: bytes, covers: Callable[[str], bool]
    ) -> list[CertificateRow]:
        # Identities of another key that `name` was or would be shared with, oldest first.
        # Also those that were revoked or have expired, and through a wildcard tail of either: who gets a name
        # gets what people and policies mean by it. `covers`: as for `check_names`.
        return [
            row
            for row in self._beside(name)
            if row.thumbprint != thumbprint and (row.name == name or row.covers(name) or covers(row.name))
        ]

    def issued_for(self, request: bytes) -> CertificateRow | None:
        found = self._find("WHERE serial = (SELECT serial FROM answer WHERE request = ?)", request)
        return found[0] if found else None

    def add(self, db: sqlite3.Connection, row: CertificateRow, now: int, request: bytes | None) -> None:
        values = (row.serial.to_bytes(20), *row[1:])
        db.execute("INSERT INTO certificate VALUES (?, ?, ?, ?, ?, ?, ?)", (*values, now))
        if request is not None:
            db.execute("INSERT INTO answer VALUES (?, ?, ?)", (request, values[0], now))
        append_entry(db, now, "certificate", row.name, row.thumbprint.hex(), digest_of(values))

    def check_key(
        self,
        name: str,
        thumbprint: bytes,
        now: int,
        *,
        replace_key: str | None = None,
        renews: bytes | None = None,
    ) -> None:
        self.check_not_revoked(name, thumbprint)
        if replace_key is not None and replace_key != name:
            raise errors.StoreError(
                f"the key of {replace_key} was to be replaced, but the request is of {name}",
                "give the name exactly, once for each request",
            )
        known = [row.thumbprint for row in self.valid(name, now)]
        if renews is not None:
            self.check_not_revoked(name, renews)
            # An older key is that of a copy or a restored disk. An authority without a record of the name (an
            # intermediate) cannot tell.
            if known and known[-1] != renews:
                raise errors.CAError(
                    f"{name} was renewed already, by another key",
                    "there is a copy of the node: revoke the name, and enroll the node again",
                )
        elif replace_key is None and set(known) - {thumbprint}:
            raise errors.StoreError(
                f"{name} has an identity with another key until it expires",
                f"if the node was set up again: --replace-key {name}; otherwise deny the request",
            )

    def check_not_revoked(self, name: str, thumbprint: bytes) -> None:
        if self._database.rows("SELECT 1 FROM revocation WHERE entry = ?", thumbprint):
            raise errors.StoreError(f"the key of {name} is revoked", "make a new key and request on the node")

    def _related(self, name: str, now: int) -> list[CertificateRow]:
        alive = " AND not_after >= ? AND thumbprint NOT IN (SELECT entry FROM revocation)"
        return self.with_valid_issuer(self._beside(name, alive, now))

    def _beside(self, name: str, clause: str = "", *values: object) -> list[CertificateRow]:
        prefixes = json.dumps([name[:size] for size in range(1, len(name))])
        return self._find(
            f"WHERE (name IN (SELECT value FROM json_each(?)) OR {_BEGINS}){clause}",  # noqa: S608  (constants)
            prefixes,
            *_beginning(name),
            *values,
        )

    def _find(self, clause: str, *values: object) -> list[CertificateRow]:
        rows = self._database.logged("certificate", clause, *values)
        return [CertificateRow(int.from_bytes(serial), *rest) for serial, *rest in rows]


def _beginning(prefix: str) -> tuple[str, str]:
    return prefix, f"{prefix}\U0010ffff"


def _signer(row: CertificateRow, made: list[CertificateRow]) -> CertificateRow | None:
    if row.name.startswith(INTERMEDIATE):  # only the root signs these
        return None
    return next((issuer for issuer in made if row.is_signed_by(issuer)), None)


class RequestTable:
    def __init__(self, database: Database, identities: IdentityTable) -> None:
        self._database = database
        self._identities = identities

    def add(self, request: svid.IdentityRequest, der: bytes, source: str, now: int) -> RequestRow:
        # `source` is where it came from, for the approver.
        self.collect(now)
        with self._database.transaction() as db:
            stored = self.find(request.digest)
            if stored is not None and now <= stored.expires:
                return stored
            if self._identities.issued_for(request.digest) is not None:
                raise errors.StoreError(
                    f"this request of {request.name} has its certificate already",
                    f"see: rossec ca show {request.name}; for another: rossec ca renew {request.name}",
                )
            waiting = self.open(now)
            # Who has an invitation must not keep out those that a person enrolls by hand.
            joining = sum(row.source.startswith(JOINING) for row in waiting)
            full = source.startswith(JOINING) and joining >= MAX_JOINING
            if full or len(waiting) >= MAX_OPEN:
                raise errors.TooManyRequests(
                    f"{MAX_OPEN} requests are pending, the maximum",
                    "list them with: rossec ca requests, and deny unknown ones",
                )
            if stored is not None:  # it expired, and is asked anew
                _delete(db, stored, now)
            asked = request.digest, request.name, request.thumbprint, der
            row = RequestRow(*asked, source, now, RequestState.PENDING, "", now)
            db.execute("INSERT INTO csr VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)", row)
            append_entry(db, now, RequestState.PENDING, row.name, source, row.digest)
        return row

    def all(self, now: int = 0) -> list[RequestRow]:
        # Every request that has not expired at `now` (0: expired ones too), oldest first.
        return self._rows(f"WHERE {_EXPIRES} >= ? ORDER BY arrived, rowid", now)

    def open(self, now: int = 0) -> list[RequestRow]:
        return self._rows(f"WHERE state IN ({_OPEN}) AND {_EXPIRES} >= ?", now)

    def find(self, digest: bytes) -> RequestRow | None:
        return next(iter(self._rows("WHERE digest = ?", digest)), None)

    def get(self, digest: bytes) -> RequestRow:
        return self.begun(digest.hex())

    def begun(self, beginning: str) -> RequestRow:
        # The one request whose digest begins so, in hexadecimal digits.
        begins = "WHERE substr(lower(hex(digest)), 1, ?) = ?"
        found = self._rows(begins, len(beginning), beginning.lower())
        if len(found) != 1 or not beginning:
            raise errors.StoreError(
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
        # `wildcard`: the identity shall cover anonymous nodes too, whatever the request says.
        with self._database.transaction():
            row = self.get(digest)
            # One of two requests for a name may be an attacker's: a person denies that one first.
            for other in self.open(now):
                if other.name == row.name and other.thumbprint != row.thumbprint:
                    raise errors.StoreError(
                        f"two different keys request the name {row.name}",
                        f"compare fingerprints, then deny the other: rossec ca deny {other.digest.hex()[:8]}",
                    )
            self._identities.check_names(
                row.name, row.thumbprint, now, lambda other: covers(row.name, other, wildcard=wildcard)
            )
            self._identities.check_key(row.name, row.thumbprint, now, replace_key=replace_key)
            approved = row._replace(replaces=replace_key is not None, wildcard=wildcard)
            return self._advance(approved, RequestState.APPROVED, now, reason)

    def deny(self, digest: bytes, now: int, reason: str = "") -> RequestRow:
        with self._database.transaction():
            return self._advance(self.get(digest), RequestState.DENIED, now, reason)

    def collect(self, now: int) -> list[RequestRow]:
        # A clock that is ahead for one look would else delete what comes back when it is right: so the newest
        # `KEPT_EXPIRED` stay, whatever the clock says, and count nowhere.
        if not self._collectable(now):  # without the lock of a transaction
            return []
        with self._database.transaction() as db:
            over = self._collectable(now)
            for row in over:
                _delete(db, row, now)
        return over

    def mark_issued(self, db: sqlite3.Connection, digest: bytes, now: int) -> None:
        stored = self.find(digest)
        if stored is None:
            raise errors.StoreError("the request is not recorded", "first: rossec ca approve REQUEST_ID")
        _update(db, advance(stored, RequestState.ISSUED, now))

    def _collectable(self, now: int) -> list[RequestRow]:
        # All but the newest of those that expired, if they did so `COLLECTED_AFTER` ago.
        newest_first = f"WHERE {_EXPIRES} < ? ORDER BY changed DESC, rowid DESC LIMIT -1 OFFSET ?"
        return self._rows(newest_first, now - COLLECTED_AFTER, KEPT_EXPIRED)

    def _advance(self, row: RequestRow, state: RequestState, now: int, reason: str) -> RequestRow:
        moved = advance(row, state, now, reason)
        with self._database.transaction() as db:
            _update(db, moved)
        return moved

    def _rows(self, clause: str, *values: object) -> list[RequestRow]:
        rows = self._database.rows(f"SELECT {_REQUESTS_COLUMNS} FROM csr {clause}", *values)  # noqa: S608  (constants)
        return [
            RequestRow(*row)._replace(state=RequestState(row[6]), replaces=row[9] != 0, wildcard=row[10] != 0)
            for row in rows
        ]


def _delete(db: sqlite3.Connection, row: RequestRow, now: int) -> None:
    db.execute("DELETE FROM csr WHERE digest = ?", (row.digest,))
    append_entry(db, now, COLLECTED, row.name, row.state, row.digest)


def _update(db: sqlite3.Connection, row: RequestRow) -> None:
    db.execute(
        "UPDATE csr SET state = ?, reason = ?, changed = ?, replaces = ?, wildcard = ? WHERE digest = ?",
        (row.state, row.reason, row.changed, row.replaces, row.wildcard, row.digest),
    )
    details = [row.reason, *["replaces the key"] * row.replaces, *["anonymous nodes"] * row.wildcard]
    append_entry(db, row.changed, row.state, row.name, "; ".join(filter(None, details)), row.digest)


class InvitationRow(NamedTuple):
    """An invitation: nodes whose names `pattern` covers may join, `uses` of them, until `expires`."""

    id: bytes  # SHA-256 of `key`
    key: bytes  # the public half of the key in its code: an uncompressed P-256 point
    pattern: str
    uses: int
    wildcard: bool  # identities for anonymous nodes too
    expires: int
    at: int


class InvitationUse(NamedTuple):
    """One identity that was issued by an invitation; `request` is the digest of its request."""

    invitation: bytes
    request: bytes
    name: str
    thumbprint: bytes
    at: int


class InvitationTable:
    def __init__(self, database: Database) -> None:
        self._database = database

    def add(self, row: InvitationRow) -> None:
        # Nodes name an invitation by its id before they prove the key: they must not come apart.
        if hashlib.sha256(row.key).digest() != row.id:
            raise ValueError("the id of an invitation is the hash of its key")
        values = (*row[:4], int(row.wildcard), *row[5:])
        with self._database.transaction() as db:
            db.execute("INSERT INTO invitation VALUES (?, ?, ?, ?, ?, ?, ?)", values)
            detail = f"{row.uses} uses, {row.id.hex()}"
            append_entry(db, row.at, "invitation", row.pattern, detail, digest_of(values))

    def all(self) -> list[InvitationRow]:
        return self._rows("ORDER BY rowid")

    def get(self, id: bytes) -> InvitationRow:  # noqa: A002 - as in the row
        found = self._rows("WHERE id = ?", id)
        if not found:
            raise errors.JoinRefused("there is no such invitation", "see: rossec ca invitations")
        return found[0]

    def uses(self, id: bytes) -> list[InvitationUse]:  # noqa: A002 - as in the row
        rows = self._database.logged("join", "WHERE invitation = ? ORDER BY rowid", id)
        return [InvitationUse(*row) for row in rows]

    def ended(self, id: bytes) -> str | None:  # noqa: A002 - as in the row
        rows = self._database.rows("SELECT reason FROM invitation_end WHERE invitation = ?", id)
        return str(rows[0][0]) if rows else None

    def take(self, use: InvitationUse) -> None:
        # To be called inside the transaction that issues the identity.
        # A request that was issued and lost on its way is asked again, and takes no second use.
        row, taken = self.get(use.invitation), self.uses(use.invitation)
        if any(known.request == use.request for known in taken):
            return
        self._check(row, len(taken), use.at)
        with self._database.transaction() as db:
            db.execute("INSERT INTO invitation_use VALUES (?, ?, ?, ?, ?)", use)
            append_entry(db, use.at, "join", use.name, use.invitation.hex(), digest_of(use))

    def check_open(self, id: bytes, now: int) -> InvitationRow:  # noqa: A002 - as in the row
        row = self.get(id)
        self._check(row, len(self.uses(id)), now)
        return row

    def end(self, id: bytes, reason: str, now: int) -> None:  # noqa: A002 - as in the row
        pattern = self.get(id).pattern
        with self._database.transaction() as db:
            row = (id, reason, now)
            done = db.execute("INSERT INTO invitation_end VALUES (?, ?, ?) ON CONFLICT DO NOTHING", row)
            if done.rowcount:
                append_entry(db, now, "invitation ended", pattern, reason, digest_of(row))

    def end_all(self, reason: str, now: int) -> None:
        # Also those that have expired: the clock may be ahead, and is set back some day.
        with self._database.transaction():
            for row in self.all():
                self.end(row.id, reason, now)

    def _check(self, row: InvitationRow, used: int, now: int) -> None:
        reason = self.ended(row.id)
        if reason is not None:
            raise errors.JoinRefused(f"the invitation was ended: {reason}", _AGAIN)
        if now > row.expires:
            raise errors.JoinRefused("the invitation has expired", _AGAIN)
        if used >= row.uses:
            raise errors.JoinRefused(f"the invitation has had its {row.uses} uses", _AGAIN)

    def _rows(self, clause: str, *values: object) -> list[InvitationRow]:
        rows = self._database.logged("invitation", clause, *values)
        return [InvitationRow(*row)._replace(wildcard=row[4] != 0) for row in rows]
