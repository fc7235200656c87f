"""The authority's record: requests, certificates, grants and revocations. SQLite, append-only.

All access goes through `Store`. Issued certificates exist and a revocation cannot be undone, so
nothing is ever changed or deleted (triggers refuse it) except requests, which expire. Every change
appends its entry to the log in the same transaction, and is on the disk when the call returns.
Callers that decide by the record and then change it do both inside `transaction`.
"""

import json
import sqlite3
from collections.abc import Collection
from pathlib import Path
from typing import Any, Self

from ca.certificates import utc
from ca.errors import StoreError
from ca.names import closest
from ca.store.database import Database, append_entry
from ca.store.identities import IdentityTable, InvitationTable, RequestTable
from ca.store.log import ApprovalState, ApprovalTable, AuthorityLog, PasskeyTable
from ca.store.signed_statements import DomainTable, ThingTable
from ca.store.values import CertificateRow, GrantRow, RevocationRow, digest_of

__all__ = ["CertificateRow", "GrantRow", "RevocationRow", "Store"]

_OF_NODES = "name IN (SELECT value FROM json_each(?))"  # one pass, however many they are


class Store:
    def __init__(self, database: Database) -> None:
        self.database = database
        self.transaction, self.close = database.transaction, database.close
        self.identities = IdentityTable(database)
        self.requests = RequestTable(database, self.identities)  # for identities
        self.invitations = InvitationTable(database)
        self.log = AuthorityLog(database)
        self.passkeys = PasskeyTable(database)
        self.approvals = ApprovalTable(database, self.passkeys, self.log)
        self.domains = DomainTable(database)  # the foreign ones that are trusted
        self.things = ThingTable(database)

    @classmethod
    def create(cls, path: Path) -> Self:
        return cls(Database.create(path))

    @classmethod
    def open(cls, path: Path) -> Self:
        return cls(Database.open(path))

    def add_certificate(
        self,
        row: CertificateRow,
        now: int,
        *,
        request: bytes | None = None,
        replace_key: str | None = None,
        renews: bytes | None = None,
    ) -> None:
        """Record an identity before it is delivered."""
        # `request` is the digest of the approved request it answers, or of the renewal; `replace_key` and
        # `renews` allow another key (`ca.store.identities`).
        with self.transaction() as db:
            self.identities.check_names(row.name, row.thumbprint, now, row.covers)
            self.identities.check_key(row.name, row.thumbprint, now, replace_key=replace_key, renews=renews)
            if request is not None and self.identities.issued_for(request) is not None:
                raise StoreError(
                    f"this request of {row.name} has its certificate already",
                    f"see: rossec ca show {row.name}",
                )
            if request is not None and renews is None:
                self.requests.mark_issued(db, request, now)
            self.identities.add(db, row, now, request)
            # In the same transaction: no crash leaves two keys for one name.
            if replace_key is not None:
                for key in sorted(self.unrevoked_keys(row.name, now) - {row.thumbprint}):
                    _revoke(db, key, f"{row.name} has a new key", now)

    def unrevoked_keys(self, name: str, now: int) -> frozenset[bytes]:
        """Thumbprints of the keys of `name` that are not revoked, and so can be."""
        # Also those certified only by a revoked intermediate: they may be certified again.
        return frozenset(row.thumbprint for row in self.identities.unrevoked(name, now))

    def valid_certificate(self, name: str, now: int) -> CertificateRow:
        """The newest identity of `name` that is still valid and not revoked."""
        alive = self.identities.valid(name, now)
        if not alive:
            if self.identities.unrevoked(name, now):
                raise StoreError(
                    f"the intermediate that signed the identity of {name} is revoked",
                    f"enroll it again: rossec node request {name}, then rossec ca sign FILE",
                )
            ended = self._newest_unrevoked(name)
            rows = self.identities.by_name(name)
            if rows and (ended is None or any(row.not_after >= now for row in rows)):
                raise StoreError(
                    f"the identity of {name} is revoked",
                    "for a new one, on its machine, move the directory of its key away, then:"
                    f" rossec node request {name}",
                )
            certified = self.identities.certified_name(name, now)
            if certified == name and ended is not None:
                raise StoreError(
                    f"the identity of {name} ended on {utc(ended.not_after)}",
                    f"rossec ca renew --expired {name}, then on its machine: rossec node install"
                    f" FILE; its key and its grants are kept",
                )
            near = closest(name, {row.name for row in self.identities.all()} - {name})
            meant = "" if near is None else f"did you mean {near}? else "
            raise StoreError(
                f"{name} has no valid identity here",
                f"{meant}first enroll it: rossec node request {name}, then"
                " rossec ca sign FILE; where an intermediate enrolled or renewed it:"
                " rossec ca import NODE.pem"
                if certified == name
                else f"it is one of the anonymous nodes of {certified}: name that",
            )
        return alive[-1]

    def renewable_certificate(self, name: str, now: int, *, expired: bool) -> CertificateRow:
        """As `valid_certificate`; with `expired` also the newest one, if it is over."""
        ended = self._newest_unrevoked(name) if expired else None
        if ended is None or self.identities.unrevoked(name, now):
            return self.valid_certificate(name, now)
        if not self.identities.with_valid_issuer([ended]):
            raise StoreError(
                f"the intermediate that signed the identity of {name} is revoked",
                f"enroll it again: rossec node request {name}, then rossec ca sign FILE",
            )
        return ended

    def _newest_unrevoked(self, name: str) -> CertificateRow | None:
        # An older key does not come back in its place.
        rows = self.identities.by_name(name)
        if not rows or rows[-1].thumbprint in self.revoked_entries():
            return None
        return rows[-1]

    def add_grant(self, row: GrantRow, now: int, rules: str = "") -> None:
        """Record a grant before it is delivered; `rules`: those of the policy it came from."""
        with self.transaction() as db:
            db.execute("INSERT INTO grant_ VALUES (?, ?, ?, ?, ?, ?)", (*row, now))
            append_entry(db, now, "grant", row.name, row.id.hex(), digest_of(row))
            if rules:
                origin = (row.id, rules)
                db.execute("INSERT INTO policy_grant VALUES (?, ?)", origin)
                append_entry(db, now, "policy grant", row.name, rules, digest_of(origin))

    def policy_grants(self, names: Collection[str] | None = None) -> dict[bytes, str]:
        """The grants that came from the policy, by id: its rules. All others were made by hand."""
        # With `names`, only those of these nodes.
        query = "SELECT id, rules FROM policy_grant"
        if names is None:
            return dict(self.database.rows(query))
        of_nodes = f"{query} WHERE id IN (SELECT id FROM grant_ WHERE {_OF_NODES})"  # noqa: S608  (constants)
        return dict(self.database.rows(of_nodes, json.dumps([*names])))

    def grants(self) -> list[GrantRow]:
        return self._grants("")

    def signed_at(self) -> dict[bytes, int]:
        return dict(self.database.rows("SELECT id, at FROM grant_"))

    def unrevoked_grants(self, names: Collection[str] | None = None) -> list[GrantRow]:
        """The grants that are not revoked, expired or not; with `names`, only of these nodes."""
        alive = "WHERE id NOT IN (SELECT entry FROM revocation)"
        if names is None:
            return self._grants(alive)
        return self._grants(f"{alive} AND {_OF_NODES}", json.dumps([*names]))

    def revoked_grants(self) -> list[GrantRow]:
        return self._grants("WHERE id IN (SELECT entry FROM revocation)")

    def _grants(self, clause: str, *values: str) -> list[GrantRow]:
        return [GrantRow(*row) for row in self.database.logged("grant", f"{clause} ORDER BY rowid", *values)]

    def revoke(self, entry: bytes, reason: str, now: int) -> None:
        with self.transaction() as db:
            _revoke(db, entry, reason, now)

    def revocations(self) -> list[RevocationRow]:
        rows = self.database.rows("SELECT entry, reason, at FROM revocation ORDER BY rowid")
        return [RevocationRow(*row) for row in rows]

    def count_revoked(self) -> int:
        ((count,),) = self.database.rows("SELECT COUNT(*) FROM revocation")
        return int(count)

    def revoked_entries(self) -> frozenset[bytes]:
        return frozenset(row.entry for row in self.revocations())

    def remove_passkey(self, id: bytes, reason: str, now: int) -> None:  # noqa: A002 - as in the row
        """End a passkey, and every approval by it that was not carried out."""
        with self.transaction():
            self.passkeys.end(id, reason, now)
            for approval in self.approvals.waiting():
                if approval.passkey == id:
                    why = f"its phone was removed: {reason}"
                    self.approvals.end(approval.id, ApprovalState.FAILED, why, now)

    def next_number(self) -> tuple[int, int]:
        number = self._newest("epoch, seq")
        return (1, 1) if number is None else (number[0], number[1] + 1)

    def save_list(self, number: tuple[int, int], data: bytes, now: int) -> None:
        with self.transaction() as db:
            db.execute("INSERT INTO list VALUES (?, ?, ?, ?)", (*number, data, now))
            append_entry(db, now, "list", f"{number[0]}.{number[1]}", "", digest_of((*number, data)))

    def newest_list(self) -> bytes | None:
        found = self._newest("data")
        return None if found is None else bytes(found[0])

    def log_event(self, what: str, subject: str, detail: str, now: int) -> None:
        with self.transaction() as db:
            append_entry(db, now, what, subject, detail, b"")

    def _newest(self, columns: str) -> tuple[Any, ...] | None:
        rows = self.database.rows(
            f"SELECT {columns} FROM list ORDER BY epoch DESC, seq DESC LIMIT 1"  # noqa: S608  (constants)
        )
        return rows[0] if rows else None


def _revoke(db: sqlite3.Connection, entry: bytes, reason: str, now: int) -> None:
    done = db.execute("INSERT INTO revocation VALUES (?, ?, ?) ON CONFLICT DO NOTHING", (entry, reason, now))
    if done.rowcount:
        append_entry(db, now, "revocation", entry.hex(), reason, digest_of((entry, reason)))
