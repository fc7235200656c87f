"""The audit of the statements about things: replayed from the log, in the order of their signing.

Each is signed by the authority and says what its row says, and no two that were in force at the
same time shared a name, a credential or a kid: the record cannot be made to hold a statement that
the authority would not have signed. The rows are those of the log already (`ca.store.log`).
"""

from collections.abc import Iterable, Iterator
from typing import Any, Final

from cryptography.hazmat.primitives.asymmetric import ec

from ca.errors import CAError, LogDamaged
from ca.store.log_entries import LogEntry
from ca.store.things import ThingRow, check_apart
from ca.things.statement import ThingStatement, peek_statement, verify_statement

KIND: Final = "thing"
_REVOCATION: Final = "revocation"
_HINT: Final = "somebody changed the record: restore a backup, and find out who"
Row = tuple[Any, ...]


def replay_things(
    entries: Iterable[LogEntry], rows: Iterable[Row], key: ec.EllipticCurvePublicKey
) -> None:
    """Check every statement; `rows` are those of the table, `key` is the root's.

    Raises:
        LogDamaged: names the first entry that could not have been made.
    """
    made, in_force = iter(rows), dict[str, ThingStatement]()
    for entry in entries:
        if entry.what == _REVOCATION:
            in_force.pop(entry.subject, None)
        elif entry.what == KIND:
            try:
                _take(entry, made, in_force, key)
            except CAError as error:
                raise LogDamaged(f"log entry {entry.number}: {error}", _HINT) from error


def _take(
    entry: LogEntry,
    made: Iterator[Row],
    in_force: dict[str, ThingStatement],
    key: ec.EllipticCurvePublicKey,
) -> None:
    row = ThingRow(*next(made))
    found = verify_statement(row.data, key, domain=peek_statement(row.data).domain)
    said = (found.id, found.name, found.not_before, found.expires)
    if said != (row.id, row.name, row.not_before, row.expires):
        raise LogDamaged(f"log entry {entry.number} says {KIND}, which cannot be", _HINT)
    for number, known in list(in_force.items()):
        if known.expires <= entry.at:
            del in_force[number]
        else:
            check_apart(known, found)
    in_force[row.id.hex()] = found
