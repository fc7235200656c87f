"""Passkeys in the authority's record: the devices that can approve.

A passkey is recorded once, by its credential id, and ends by an entry that says why. One that has
ended never comes back: the device registers another.
"""

from ca.approvals.assertion import Passkey
from ca.errors import PasskeyUnknown, StoreError
from ca.store.database import Database
from ca.store.log_entries import digest_of
from ca.store.schema import append_entry

_COLUMNS = "id, name, cose_key, aaguid, rp_id, origin, approval, at"


class PasskeyTable:
    """The passkeys of one record."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def add(self, passkey: Passkey) -> None:
        """Record a passkey.

        Raises:
            StoreError: it is, or was, recorded already, or one in use has its name.
        """
        with self._database.transaction() as db:
            if any(known.name == passkey.name for known in self.active()):
                raise StoreError(
                    f"there is a passkey called {passkey.name!a}",
                    "choose another name, or remove that one: rossec console phones remove NAME",
                )
            db.execute("INSERT INTO passkey VALUES (?, ?, ?, ?, ?, ?, ?, ?)", passkey)
            append_entry(
                db, passkey.at, "passkey", passkey.name, passkey.id.hex(), digest_of(passkey)
            )

    def all(self) -> list[Passkey]:
        """Every passkey, oldest first, also those that have ended."""
        return self._rows("ORDER BY rowid")

    def active(self) -> list[Passkey]:
        """The passkeys that can approve, oldest first."""
        return self._rows("WHERE id NOT IN (SELECT passkey FROM passkey_end) ORDER BY rowid")

    def get(self, id: bytes) -> Passkey:  # noqa: A002 - as in the row
        """A passkey that can approve.

        Raises:
            PasskeyUnknown: there is none, or it has ended.
        """
        for passkey in self.active():
            if passkey.id == id:
                return passkey
        raise PasskeyUnknown(
            "this passkey is not registered here, or was removed",
            "register the phone: rossec console phone",
        )

    def ended(self) -> dict[bytes, str]:
        """Why passkeys ended, by their credential id."""
        return dict(self._database.rows("SELECT passkey, reason FROM passkey_end"))

    def end(self, id: bytes, reason: str, now: int) -> None:  # noqa: A002 - as in the row
        """End a passkey for ever.

        Raises:
            PasskeyUnknown: there is none, or it has ended.
        """
        with self._database.transaction() as db:
            passkey, row = self.get(id), (id, reason, now)
            db.execute("INSERT INTO passkey_end VALUES (?, ?, ?)", row)
            append_entry(db, now, "passkey ended", passkey.name, reason, digest_of(row))

    def end_all(self, reason: str, now: int) -> int:
        """End every passkey; returns how many."""
        with self._database.transaction():
            active = self.active()
            for passkey in active:
                self.end(passkey.id, reason, now)
        return len(active)

    def _rows(self, clause: str) -> list[Passkey]:
        rows = self._database.rows(f"SELECT {_COLUMNS} FROM passkey {clause}")  # noqa: S608  (constants)
        return [Passkey(*row) for row in rows]
