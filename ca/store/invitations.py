"""Invitations in the authority's record: nodes that join by a code, without a person each time.

A use is one identity for one new name. It is recorded in the transaction that issues the identity,
so that two commands never share the last use; the same request uses an invitation once. An
invitation ends by its time, by its number of uses, or by an entry that says why.
"""

import hashlib
from typing import NamedTuple

from ca.errors import InvitationRefused
from ca.store.database import Database
from ca.store.log_entries import digest_of
from ca.store.schema import append_entry

_COLUMNS = "id, key, pattern, uses, wildcard, expires, at"


class InvitationRow(NamedTuple):
    """An invitation: nodes whose names `pattern` covers may join, `uses` of them, until `expires`.

    `key` is the public half of the key in its code (an uncompressed P-256 point, 65 bytes), `id`
    the SHA-256 of `key`; `wildcard`: identities for anonymous nodes too.
    """

    id: bytes
    key: bytes
    pattern: str
    uses: int
    wildcard: bool
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
    """The tables of invitations, their uses and their ends."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def add(self, row: InvitationRow) -> None:
        """Record an invitation.

        Raises:
            ValueError: `id` is not that of `key`.
            StoreError: it is recorded already.
        """
        if hashlib.sha256(row.key).digest() != row.id:
            raise ValueError("the id of an invitation is the hash of its key")
        values = (*row[:4], int(row.wildcard), *row[5:])
        with self._database.transaction() as db:
            db.execute("INSERT INTO invitation VALUES (?, ?, ?, ?, ?, ?, ?)", values)
            detail = f"{row.uses} uses, {row.id.hex()}"
            append_entry(db, row.at, "invitation", row.pattern, detail, digest_of(values))

    def all(self) -> list[InvitationRow]:
        """Every invitation, oldest first, also those that have ended."""
        return self._rows("ORDER BY rowid")

    def get(self, id: bytes) -> InvitationRow:  # noqa: A002 - as in the row
        """One invitation.

        Raises:
            InvitationRefused: there is none.
        """
        found = self._rows("WHERE id = ?", id)
        if not found:
            raise InvitationRefused("there is no such invitation", "see: rossec ca invitations")
        return found[0]

    def uses(self, id: bytes) -> list[InvitationUse]:  # noqa: A002 - as in the row
        """The identities that were issued by an invitation, oldest first."""
        query = (
            "SELECT invitation, request, name, thumbprint, at FROM invitation_use"
            " WHERE invitation = ? ORDER BY rowid"
        )
        return [InvitationUse(*row) for row in self._database.rows(query, id)]

    def ended(self, id: bytes) -> str | None:  # noqa: A002 - as in the row
        """Why an invitation was ended, if it was."""
        rows = self._database.rows("SELECT reason FROM invitation_end WHERE invitation = ?", id)
        return str(rows[0][0]) if rows else None

    def take(self, use: InvitationUse) -> None:
        """Record a use; again for the same request: nothing.

        To be called inside the transaction that issues the identity.

        Raises:
            InvitationRefused: unknown, ended, expired at `use.at`, or used up.
        """
        row, taken = self.get(use.invitation), self.uses(use.invitation)
        if any(known.request == use.request for known in taken):
            return
        self._check(row, len(taken), use.at)
        with self._database.transaction() as db:
            db.execute("INSERT INTO invitation_use VALUES (?, ?, ?, ?, ?)", use)
            append_entry(db, use.at, "join", use.name, use.invitation.hex(), digest_of(use))

    def check_open(self, id: bytes, now: int) -> InvitationRow:  # noqa: A002 - as in the row
        """The invitation, if it can be used at `now`.

        Raises:
            InvitationRefused: as `take`.
        """
        row = self.get(id)
        self._check(row, len(self.uses(id)), now)
        return row

    def end(self, id: bytes, reason: str, now: int) -> None:  # noqa: A002 - as in the row
        """End an invitation; ending it again changes nothing.

        Raises:
            InvitationRefused: there is none.
        """
        pattern = self.get(id).pattern
        with self._database.transaction() as db:
            row = (id, reason, now)
            done = db.execute(
                "INSERT INTO invitation_end VALUES (?, ?, ?) ON CONFLICT DO NOTHING", row
            )
            if done.rowcount:
                append_entry(db, now, "invitation ended", pattern, reason, digest_of(row))

    def end_all(self, reason: str, now: int) -> None:
        """End every invitation that has not ended.

        Also those that have expired: the clock may be ahead, and is set back some day.
        """
        with self._database.transaction():
            for row in self.all():
                self.end(row.id, reason, now)

    def _check(self, row: InvitationRow, used: int, now: int) -> None:
        reason = self.ended(row.id)
        if reason is not None:
            raise InvitationRefused(f"the invitation was ended: {reason}", _AGAIN)
        if now > row.expires:
            raise InvitationRefused("the invitation has expired", _AGAIN)
        if used >= row.uses:
            raise InvitationRefused(f"the invitation has had its {row.uses} uses", _AGAIN)

    def _rows(self, clause: str, *values: object) -> list[InvitationRow]:
        rows = self._database.rows(f"SELECT {_COLUMNS} FROM invitation {clause}", *values)  # noqa: S608  (constants)
        return [InvitationRow(*row)._replace(wildcard=row[4] != 0) for row in rows]


_AGAIN = "make another: rossec ca invite PATTERN"
