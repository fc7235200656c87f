"""Foreign domains in the authority's record: accepted, changed, ended; the lists that were signed.

Each acceptance and each change of terms is a row, and the newest row of a domain counts until an
end refers to it. What was accepted never goes from the record: a label that once meant a domain is
not given to another one while a grant that names it can live (`rossec.authority.domains` asks
`labelled`). A domain is its root key here: whoever has another key is another domain.
"""

from typing import NamedTuple

from ca.certificates import Identity
from ca.domains.lists import ForeignDomain
from ca.errors import DomainUnknown, StoreError
from ca.store.database import Database
from ca.store.log_entries import digest_of
from ca.store.schema import append_entry

_COLUMNS = "number, domain, label, root, terms, at"
_NEWEST = "number IN (SELECT max(number) FROM foreign_domain GROUP BY domain)"
_NOT_ENDED = "number NOT IN (SELECT number FROM foreign_domain_end)"


class DomainRow(NamedTuple):
    """One acceptance of a domain, or change of its terms; `root` is its key's thumbprint."""

    number: int
    domain: str
    label: str
    root: bytes
    terms: bytes
    at: int

    def read(self) -> ForeignDomain:
        """The terms, as a value."""
        return ForeignDomain.from_terms(self.terms)


class ForeignCertificateRow(NamedTuple):
    """A certificate of a foreign node: its key, the root key above it, its name there."""

    thumbprint: bytes
    root: bytes
    name: str
    der: bytes
    at: int


class DomainTable:
    """The foreign domains of one record."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def accepted(self) -> list[DomainRow]:
        """The domains that are trusted, sorted by name; the time of some may be over."""
        return self._rows(f"WHERE {_NEWEST} AND {_NOT_ENDED} ORDER BY domain")

    def all(self) -> list[DomainRow]:
        """Every acceptance and change, oldest first."""
        return self._rows("ORDER BY number")

    def get(self, label: str) -> DomainRow:
        """The trusted domain that has this label.

        Raises:
            DomainUnknown: there is none.
        """
        for row in self.accepted():
            if row.label == label:
                return row
        raise DomainUnknown(f"no domain is called {label!a} here", "see: rossec domain list")

    def labelled(self, label: str) -> list[DomainRow]:
        """Every row with this label, oldest first, also of domains that have ended."""
        return self._rows("WHERE label = ? ORDER BY number", label)

    def ends(self) -> dict[int, tuple[str, int]]:
        """Why and when domains ended, by the number of their row."""
        rows = self._database.rows("SELECT number, reason, at FROM foreign_domain_end")
        return {number: (reason, at) for number, reason, at in rows}

    def accept(self, domain: ForeignDomain, now: int) -> None:
        """Trust a domain, or change the terms of one that is trusted.

        Raises:
            StoreError: another domain has the label or the root key, or this one another of both.
        """
        with self._database.transaction() as db:
            root = domain.anchor.thumbprint
            for known in self.accepted():
                check_apart(known, domain.domain, domain.label, root)
            number = self._next_row()
            row = DomainRow(number, domain.domain, domain.label, root, domain.terms, now)
            db.execute("INSERT INTO foreign_domain VALUES (?, ?, ?, ?, ?, ?)", row)
            append_entry(db, now, "domain", row.domain, row.label, digest_of(row))

    def end(self, label: str, reason: str, now: int) -> DomainRow:
        """End the trust in a domain; returns what ended.

        Raises:
            DomainUnknown: no trusted domain has this label.
        """
        with self._database.transaction() as db:
            row = self.get(label)
            ended = (row.number, reason, now)
            db.execute("INSERT INTO foreign_domain_end VALUES (?, ?, ?)", ended)
            append_entry(db, now, "domain ended", row.domain, reason, digest_of(ended))
        return row

    def next_number(self) -> tuple[int, int]:
        """Epoch and sequence number for the next list of domains."""
        rows = self._database.rows(
            "SELECT epoch, seq FROM domain_list ORDER BY epoch DESC, seq DESC LIMIT 1"
        )
        return (rows[0][0], rows[0][1] + 1) if rows else (1, 1)

    def save_list(self, number: tuple[int, int], data: bytes, now: int) -> None:
        """Record a signed list of domains.

        Raises:
            StoreError: its number is taken.
        """
        with self._database.transaction() as db:
            db.execute("INSERT INTO domain_list VALUES (?, ?, ?, ?)", (*number, data, now))
            subject = f"{number[0]}.{number[1]}"
            append_entry(db, now, "domain list", subject, "", digest_of((*number, data)))

    def newest_list(self) -> bytes:
        """The signed list with the highest number; empty: none was ever signed."""
        rows = self._database.rows(
            "SELECT data FROM domain_list ORDER BY epoch DESC, seq DESC LIMIT 1"
        )
        return bytes(rows[0][0]) if rows else b""

    def add_certificate(self, root: bytes, identity: Identity, now: int) -> None:
        """Record the certificate of a foreign node, verified below the root key `root`; once."""
        row = ForeignCertificateRow(
            identity.thumbprint, root, identity.certified_name, identity.certificate, now
        )
        with self._database.transaction() as db:
            if any(known.der == row.der for known in self.certificates(root)):
                return
            db.execute("INSERT INTO foreign_certificate VALUES (?, ?, ?, ?, ?)", row)
            key = row.thumbprint.hex()
            append_entry(db, now, "foreign certificate", row.name, key, digest_of(row))

    def certificates(self, root: bytes) -> list[ForeignCertificateRow]:
        """The recorded certificates below a root key, oldest first."""
        rows = self._database.rows(
            "SELECT thumbprint, root, name, der, at FROM foreign_certificate"
            " WHERE root = ? ORDER BY rowid",
            root,
        )
        return [ForeignCertificateRow(*row) for row in rows]

    def _next_row(self) -> int:
        rows = self._database.rows("SELECT coalesce(max(number), 0) + 1 FROM foreign_domain")
        return int(rows[0][0])

    def _rows(self, clause: str, *values: object) -> list[DomainRow]:
        rows = self._database.rows(f"SELECT {_COLUMNS} FROM foreign_domain {clause}", *values)  # noqa: S608  (constants)
        return [DomainRow(*row) for row in rows]


def check_apart(known: DomainRow, domain: str, label: str, root: bytes) -> None:
    """Return if a domain with this name, label and root key may be trusted beside `known`.

    Raises:
        StoreError: they share one or two of the three, but not all.
    """
    same = (known.domain == domain, known.label == label, known.root == root)
    if all(same) or not any(same):
        return
    if known.domain == domain and known.root != root:
        raise StoreError(
            f"domain {domain} has another root key than before",
            "find out why, by telephone; if it was set up again:"
            f" rossec domain remove {known.label}, then accept it anew",
        )
    if known.domain == domain:
        raise StoreError(f"domain {domain} is called {known.label} here", f"--as {known.label}")
    if known.label == label:
        raise StoreError(
            f"the label {label} is that of domain {known.domain}", "choose another label: --as"
        )
    raise StoreError(
        f"domain {known.domain} has the same root key",
        "one authority has one domain: ask them which one it is",
    )
