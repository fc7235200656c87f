"""The statements about constrained things in the authority's record.

A statement is in force until it expires or is revoked. Among those in force, one name is one thing
and one credential is one thing; at one border router, so is one kid. A statement that would break
this is refused: its caller first revokes what it replaces, in the same transaction. A repeated
statement about the same thing at the same router is a renewal, and ends nothing.
"""

from typing import NamedTuple

from ca.errors import ThingChanged, ThingUnknown
from ca.store.database import Database
from ca.store.log_entries import digest_of
from ca.store.schema import append_entry
from ca.things.statement import ThingStatement, peek_statement

_COLUMNS = "id, name, border, data, not_before, expires"
_IN_FORCE = "expires > ? AND id NOT IN (SELECT entry FROM revocation)"


class ThingRow(NamedTuple):
    """One signed statement; `border` is the name of the router with the key in it."""

    id: bytes
    name: str
    border: str
    data: bytes
    not_before: int
    expires: int

    def read(self) -> ThingStatement:
        """What it states."""
        return peek_statement(self.data)


class ThingTable:
    """The statements of one record."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def all(self) -> list[ThingRow]:
        """Every statement signed, oldest first."""
        return self._rows("ORDER BY rowid")

    def in_force(self, now: int) -> list[ThingRow]:
        """Those neither expired nor revoked, oldest first; the newest of a name counts."""
        return self._rows(f"WHERE {_IN_FORCE} ORDER BY rowid", now)

    def newest(self, now: int) -> dict[str, ThingRow]:
        """The statement in force of each name that counts."""
        return {row.name: row for row in self.in_force(now)}

    def get(self, name: str, now: int) -> ThingRow:
        """The statement in force about `name`.

        Raises:
            ThingUnknown: there is none.
        """
        found = self._rows(f"WHERE name = ? AND {_IN_FORCE} ORDER BY rowid", name, now)
        if not found:
            raise ThingUnknown(
                f"no statement about a thing {name} is in force", "see: rossec ca things --all"
            )
        return found[-1]

    def last(self, name: str) -> ThingRow:
        """The last statement about `name` that was not revoked; it may have expired.

        Raises:
            ThingUnknown: there is none.
        """
        alive = "WHERE name = ? AND id NOT IN (SELECT entry FROM revocation) ORDER BY rowid"
        found = self._rows(alive, name)
        if not found:
            raise ThingUnknown(f"there is no thing {name}", "see: rossec ca things --all")
        return found[-1]

    def revoked(self) -> list[ThingRow]:
        """The revoked statements, oldest first."""
        return self._rows("WHERE id IN (SELECT entry FROM revocation) ORDER BY rowid")

    def ids(self, name: str, now: int) -> frozenset[bytes]:
        """The ids of all statements in force about `name`."""
        return frozenset(row.id for row in self.in_force(now) if row.name == name)

    def of_border(self, border: str, now: int) -> list[ThingRow]:
        """The statements in force that name a key of this border router, oldest first."""
        return [row for row in self.in_force(now) if row.border == border]

    def add(self, row: ThingRow, statement: ThingStatement, now: int) -> None:
        """Record a statement before it is delivered.

        Raises:
            ThingChanged: another thing in force has the name, the credential, or the kid.
            StoreError: the id is taken.
        """
        with self._database.transaction() as db:
            for known in self.in_force(now):
                check_apart(known.read(), statement)
            db.execute("INSERT INTO thing VALUES (?, ?, ?, ?, ?, ?, ?)", (*row, now))
            append_entry(db, now, "thing", row.name, row.id.hex(), digest_of(row))

    def _rows(self, clause: str, *values: object) -> list[ThingRow]:
        rows = self._database.rows(f"SELECT {_COLUMNS} FROM thing {clause}", *values)  # noqa: S608  (constants)
        return [ThingRow(*row) for row in rows]


def check_apart(known: ThingStatement, new: ThingStatement) -> None:
    """Return if both may be in force at the same time.

    Raises:
        ThingChanged: they share a name, a credential or a kid, and are not about one thing.
    """
    same_thing = known.credential.thumbprint == new.credential.thumbprint
    if (known.name, known.border) == (new.name, new.border) and known.credential == new.credential:
        return
    if known.name == new.name:
        what = "another border router" if same_thing else "another key"
        raise ThingChanged(
            f"{new.name} has a statement in force with {what}",
            f"if that one is to end: --replace {new.name}",
        )
    if same_thing:
        raise ThingChanged(
            f"this key is that of {known.name}",
            f"if the thing was renamed: --replace {known.name}",
        )
    if (known.border, known.credential.kid) == (new.border, new.credential.kid):
        raise ThingChanged(
            f"{known.name} has the same kid {known.credential.kid.hex()} at this border router",
            f"give one of the two another kid, or --replace {known.name}",
        )
