"""The identities in the authority's record: which were signed, and which key a name may have.

A name keeps its key. Another key is accepted in three cases only: the name has no valid identity;
the operator gives the name again (`replace_key`); or the newest valid key itself signs the renewal
(`renews`). A renewal by an older key comes from a copy or a restored disk and is refused.
"""

import json
import sqlite3
from collections.abc import Callable

from ca.errors import KeyChanged, NameCovered, RenewalRefused, StoreError
from ca.names import MASTER, is_master_name
from ca.store.database import Database
from ca.store.log_entries import digest_of
from ca.store.rows import INTERMEDIATE, CertificateRow
from ca.store.schema import append_entry

_COLUMNS = "serial, name, thumbprint, der, not_before, not_after"
_BEGINS = "(name >= ? AND name < ?)"  # by the index on names, where substr() reads every row


class IdentityTable:
    """The table of certificates."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def all(self) -> list[CertificateRow]:
        """Every identity signed, oldest first."""
        return self._find("ORDER BY rowid")

    def by_name(self, name: str) -> list[CertificateRow]:
        """Every identity of `name`, oldest first."""
        return self._find("WHERE name = ? ORDER BY rowid", name)

    def valid(self, name: str, now: int) -> list[CertificateRow]:
        """The valid identities of `name`: not expired, and no key of the chain is revoked."""
        return self.with_valid_issuer(self.unrevoked(name, now))

    def all_valid(self, now: int) -> list[CertificateRow]:
        """As `valid`, of every name, oldest first."""
        alive = "WHERE not_after >= ? AND thumbprint NOT IN (SELECT entry FROM revocation)"
        return self.with_valid_issuer(self._find(f"{alive} ORDER BY rowid", now))

    def valid_masters(self, now: int) -> list[CertificateRow]:
        """As `valid`, of every name that a master is certified for, oldest first."""
        found = self._find(
            f"WHERE (name = ? OR {_BEGINS}) AND not_after >= ?"  # noqa: S608  (constants)
            " AND thumbprint NOT IN (SELECT entry FROM revocation) ORDER BY rowid",
            MASTER, *_beginning(f"{MASTER}/"), now,
        )  # fmt: skip
        return self.with_valid_issuer([row for row in found if is_master_name(row.name)])

    def unrevoked(self, name: str, now: int) -> list[CertificateRow]:
        """Those not expired whose own key is not revoked: the ones that can still be revoked."""
        return self._find(
            "WHERE name = ? AND not_after >= ?"
            " AND thumbprint NOT IN (SELECT entry FROM revocation) ORDER BY rowid",
            name, now,
        )  # fmt: skip

    def with_valid_issuer(self, rows: list[CertificateRow]) -> list[CertificateRow]:
        """Those of `rows` that were not signed by a revoked intermediate."""
        ended = self._find(
            f"WHERE {_BEGINS} AND thumbprint IN (SELECT entry FROM revocation)",  # noqa: S608  (constants)
            *_beginning(INTERMEDIATE),
        )
        return [row for row in rows if _signer(row, ended) is None]

    def issuer(self, row: CertificateRow) -> CertificateRow | None:
        """The intermediate of this record that signed `row`, newest first; None: the authority."""
        clause = f"WHERE {_BEGINS} ORDER BY rowid DESC"
        return _signer(row, self._find(clause, *_beginning(INTERMEDIATE)))

    def certified_name(self, name: str, now: int) -> str:
        """The certified name that grants, rules and revocations of the node `name` refer to.

        It is `name` itself or, for an anonymous node, that of the valid identity that covers it.
        """
        covering = (row.name for row in self._related(name, now) if row.covers(name))
        return max(covering, key=len, default=name)

    def check_names(
        self, name: str, thumbprint: bytes, now: int, covers: Callable[[str], bool]
    ) -> None:
        """Return if no two keys would share a name, also not through a wildcard tail.

        `covers(other)`: whether the new identity would cover `other`.

        Raises:
            NameCovered: they would.
        """
        for known in self._related(name, now):
            overlap = known.covers(name) or covers(known.name)
            if known.thumbprint != thumbprint and known.name != name and overlap:
                raise NameCovered(
                    f"{name} and {known.name}: one is for anonymous nodes and covers the other",
                    f"choose another name, or revoke {known.name} first",
                )

    def ever_shared(
        self, name: str, thumbprint: bytes, covers: Callable[[str], bool]
    ) -> list[CertificateRow]:
        """Identities of another key that `name` was or would be shared with, oldest first.

        Also those that were revoked or have expired, and through a wildcard tail of either: who
        gets a name gets what people and policies mean by it. `covers`: as for `check_names`.
        """
        return [
            row
            for row in self._beside(name)
            if row.thumbprint != thumbprint
            and (row.name == name or row.covers(name) or covers(row.name))
        ]

    def issued_for(self, request: bytes) -> CertificateRow | None:
        """The certificate that was issued for the request with this digest."""
        found = self._find("WHERE serial = (SELECT serial FROM answer WHERE request = ?)", request)
        return found[0] if found else None

    def add(
        self, db: sqlite3.Connection, row: CertificateRow, now: int, request: bytes | None
    ) -> None:
        """Add an identity, inside the caller's transaction."""
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
        """Return if `name` may be certified with the key `thumbprint`.

        Raises:
            KeyChanged: it has another key, and `replace_key` was not given.
            RenewalRefused: `renews` is not its newest key.
            StoreError: the key is revoked, or `replace_key` is another name.
        """
        self.check_not_revoked(name, thumbprint)
        if replace_key is not None and replace_key != name:
            raise StoreError(
                f"the key of {replace_key} was to be replaced, but the request is of {name}",
                "give the name exactly, once for each request",
            )
        known = [row.thumbprint for row in self.valid(name, now)]
        if renews is not None:
            self.check_not_revoked(name, renews)
            _check_newest(name, known, renews)
        elif replace_key is None and set(known) - {thumbprint}:
            raise KeyChanged(
                f"{name} has an identity with another key until it expires",
                f"if the node was set up again: --replace-key {name}; otherwise deny the request",
            )

    def check_not_revoked(self, name: str, thumbprint: bytes) -> None:
        """Return if the key `thumbprint` of `name` is not revoked.

        Raises:
            StoreError: it is.
        """
        if self._database.rows("SELECT 1 FROM revocation WHERE entry = ?", thumbprint):
            raise StoreError(
                f"the key of {name} is revoked", "make a new key and request on the node"
            )

    def _related(self, name: str, now: int) -> list[CertificateRow]:
        """Unexpired, unrevoked identities whose name is a prefix of `name`, or the reverse."""
        alive = " AND not_after >= ? AND thumbprint NOT IN (SELECT entry FROM revocation)"
        return self.with_valid_issuer(self._beside(name, alive, now))

    def _beside(self, name: str, clause: str = "", *values: object) -> list[CertificateRow]:
        """All identities whose name is `name`, or a prefix of it, or the reverse."""
        prefixes = json.dumps([name[:size] for size in range(1, len(name))])
        return self._find(
            f"WHERE (name IN (SELECT value FROM json_each(?)) OR {_BEGINS}){clause}",  # noqa: S608  (constants)
            prefixes, *_beginning(name), *values,
        )  # fmt: skip

    def _find(self, clause: str, *values: object) -> list[CertificateRow]:
        rows = self._database.rows(f"SELECT {_COLUMNS} FROM certificate {clause}", *values)  # noqa: S608  (constants)
        return [CertificateRow(int.from_bytes(serial), *rest) for serial, *rest in rows]


def _beginning(prefix: str) -> tuple[str, str]:
    """The bounds of `_BEGINS` for names that begin with `prefix`, in the order of their UTF-8."""
    return prefix, f"{prefix}\U0010ffff"


def _signer(row: CertificateRow, made: list[CertificateRow]) -> CertificateRow | None:
    if row.name.startswith(INTERMEDIATE):  # only the root signs these
        return None
    return next((issuer for issuer in made if row.is_signed_by(issuer)), None)


def _check_newest(name: str, known: list[bytes], renews: bytes) -> None:
    """Refuse older keys; an authority without a record of the name (an intermediate) cannot."""
    if known and known[-1] != renews:
        raise RenewalRefused(
            f"{name} was renewed already, by another key",
            "there is a copy of the node: revoke the name, and enroll the node again",
        )
