"""Foreign domains and constrained things in the authority's record.

Each acceptance of a domain and each change of its terms is a row, and the newest row counts until
an end refers to it. Of the statements about things in force, one name is one thing and one
credential is one thing; at one border router, so is one kid.
"""

from typing import NamedTuple

from ca.certificates import Identity
from ca.domains import ForeignDomain
from ca.errors import DomainUnknown, StoreError
from ca.store.database import Database, append_entry
from ca.store.values import digest_of
from ca.things import ThingStatement, peek_statement

_NEWEST = "number IN (SELECT max(number) FROM foreign_domain GROUP BY domain)"
_NOT_ENDED = "number NOT IN (SELECT number FROM foreign_domain_end)"

_IN_FORCE = "expires > ? AND id NOT IN (SELECT entry FROM revocation)"


class DomainRow(NamedTuple):
    """One acceptance of a domain, or change of its terms; `root` is its key's thumbprint."""

    number: int
    domain: str
    label: str
    root: bytes
    terms: bytes
    at: int

    def read(self) -> ForeignDomain:
        return ForeignDomain.from_terms(self.terms)


class ForeignCertificateRow(NamedTuple):
    thumbprint: bytes
    root: bytes
    name: str
    der: bytes
    at: int


class DomainTable:
    def __init__(self, database: Database) -> None:
        self._database = database

    def accepted(self) -> list[DomainRow]:
        return self._rows(f"WHERE {_NEWEST} AND {_NOT_ENDED} ORDER BY domain")

    def all(self) -> list[DomainRow]:
        return self._rows("ORDER BY number")

    def get(self, label: str) -> DomainRow:
        for row in self.accepted():
            if row.label == label:
                return row
        raise DomainUnknown(f"no domain is called {label!a} here", "see: rossec domain list")

    def labelled(self, label: str) -> list[DomainRow]:
        return self._rows("WHERE label = ? ORDER BY number", label)

    def ends(self) -> dict[int, tuple[str, int]]:
        return {number: (reason, at) for number, reason, at in self._database.logged("domain ended")}

    def accept(self, domain: ForeignDomain, now: int) -> None:
        with self._database.transaction() as db:
            root = domain.anchor.thumbprint
            for known in self.accepted():
                check_domains_apart(known, domain.domain, domain.label, root)
            rows = self._database.rows("SELECT coalesce(max(number), 0) + 1 FROM foreign_domain")
            number = int(rows[0][0])
            row = DomainRow(number, domain.domain, domain.label, root, domain.terms, now)
            db.execute("INSERT INTO foreign_domain VALUES (?, ?, ?, ?, ?, ?)", row)
            append_entry(db, now, "domain", row.domain, row.label, digest_of(row))

    def end(self, label: str, reason: str, now: int) -> DomainRow:
        with self._database.transaction() as db:
            row = self.get(label)
            ended = (row.number, reason, now)
            db.execute("INSERT INTO foreign_domain_end VALUES (?, ?, ?)", ended)
            append_entry(db, now, "domain ended", row.domain, reason, digest_of(ended))
        return row

    def next_number(self) -> tuple[int, int]:
        rows = self._database.rows("SELECT epoch, seq FROM domain_list ORDER BY epoch DESC, seq DESC LIMIT 1")
        return (rows[0][0], rows[0][1] + 1) if rows else (1, 1)

    def save_list(self, number: tuple[int, int], data: bytes, now: int) -> None:
        with self._database.transaction() as db:
            db.execute("INSERT INTO domain_list VALUES (?, ?, ?, ?)", (*number, data, now))
            subject = f"{number[0]}.{number[1]}"
            append_entry(db, now, "domain list", subject, "", digest_of((*number, data)))

    def newest_list(self) -> bytes:
        rows = self._database.rows("SELECT data FROM domain_list ORDER BY epoch DESC, seq DESC LIMIT 1")
        return bytes(rows[0][0]) if rows else b""

    def add_certificate(self, root: bytes, identity: Identity, now: int) -> None:
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
        rows = self._database.logged("foreign certificate", "WHERE root = ? ORDER BY rowid", root)
        return [ForeignCertificateRow(*row) for row in rows]

    def _rows(self, clause: str, *values: object) -> list[DomainRow]:
        return [DomainRow(*row) for row in self._database.logged("domain", clause, *values)]


def check_domains_apart(known: DomainRow, domain: str, label: str, root: bytes) -> None:
    """Return if a domain with this name, label and root key may be trusted beside `known`."""
    same = (known.domain == domain, known.label == label, known.root == root)
    if all(same) or not any(same):
        return
    # Whoever has another root key is another domain, and perhaps somebody who would like to be that one.
    if known.domain == domain and known.root != root:
        raise StoreError(
            f"domain {domain} has another root key than before",
            "find out why, by telephone; if it was set up again:"
            f" rossec domain remove {known.label}, then accept it anew",
        )
    if known.domain == domain:
        raise StoreError(f"domain {domain} is called {known.label} here", f"--as {known.label}")
    if known.label == label:
        raise StoreError(f"the label {label} is that of domain {known.domain}", "choose another label: --as")
    raise StoreError(
        f"domain {known.domain} has the same root key",
        "one authority has one domain: ask them which one it is",
    )


class ThingRow(NamedTuple):
    """One signed statement; `border` is the name of the router with the key in it."""

    id: bytes
    name: str
    border: str
    data: bytes
    not_before: int
    expires: int

    def read(self) -> ThingStatement:
        return peek_statement(self.data)


class ThingTable:
    def __init__(self, database: Database) -> None:
        self._database = database

    def all(self) -> list[ThingRow]:
        return self._rows("ORDER BY rowid")

    def in_force(self, now: int) -> list[ThingRow]:
        return self._rows(f"WHERE {_IN_FORCE} ORDER BY rowid", now)

    def newest(self, now: int) -> dict[str, ThingRow]:
        return {row.name: row for row in self.in_force(now)}

    def get(self, name: str, now: int) -> ThingRow:
        found = self._rows(f"WHERE name = ? AND {_IN_FORCE} ORDER BY rowid", name, now)
        if not found:
            raise StoreError(f"no statement about a thing {name} is in force", "see: rossec ca things --all")
        return found[-1]

    def last(self, name: str) -> ThingRow:
        # The last statement about `name` that was not revoked; it may have expired.
        alive = "WHERE name = ? AND id NOT IN (SELECT entry FROM revocation) ORDER BY rowid"
        found = self._rows(alive, name)
        if not found:
            raise StoreError(f"there is no thing {name}", "see: rossec ca things --all")
        return found[-1]

    def revoked(self) -> list[ThingRow]:
        return self._rows("WHERE id IN (SELECT entry FROM revocation) ORDER BY rowid")

    def ids(self, name: str, now: int) -> frozenset[bytes]:
        return frozenset(row.id for row in self.in_force(now) if row.name == name)

    def add(self, row: ThingRow, statement: ThingStatement, now: int) -> None:
        with self._database.transaction() as db:
            for known in self.in_force(now):
                check_things_apart(known.read(), statement)
            db.execute("INSERT INTO thing VALUES (?, ?, ?, ?, ?, ?, ?)", (*row, now))
            append_entry(db, now, "thing", row.name, row.id.hex(), digest_of(row))

    def _rows(self, clause: str, *values: object) -> list[ThingRow]:
        return [ThingRow(*row) for row in self._database.logged("thing", clause, *values)]


def check_things_apart(known: ThingStatement, new: ThingStatement) -> None:
    same_thing = known.credential.thumbprint == new.credential.thumbprint
    if (known.name, known.border) == (new.name, new.border) and known.credential == new.credential:
        return
    if known.name == new.name:
        what = "another border router" if same_thing else "another key"
        raise StoreError(
            f"{new.name} has a statement in force with {what}", f"if that one is to end: --replace {new.name}"
        )
    if same_thing:
        raise StoreError(
            f"this key is that of {known.name}", f"if the thing was renamed: --replace {known.name}"
        )
    # A handshake names the key by its kid alone, so the router could not tell the two apart.
    if (known.border, known.credential.kid) == (new.border, new.credential.kid):
        raise StoreError(
            f"{known.name} has the same kid {known.credential.kid.hex()} at this border router",
            f"give one of the two another kid, or --replace {known.name}",
        )
