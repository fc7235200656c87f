"""Statements about things, signed and recorded."""

from dataclasses import replace
from typing import Any, Final

from ca.keys.signing import thumbprint
from ca.store.record import Store
from ca.store.signed_statements import ThingRow
from ca.things import ThingKey, ThingStatement, sign_statement
from tests.vectors.make_things import HOME, NOW, OTHER, STATEMENTS

LAMP: Final = STATEMENTS["a key"]
BORDER: Final = "/border"
FAN: Final = replace(
    LAMP, name="/things/fan", credential=ThingKey.of(OTHER.public_key, b"\x2c"), serial=b"f" * 16
)


def again(statement: ThingStatement, serial: int, **changes: Any) -> ThingStatement:
    """Another statement about the same thing."""
    return replace(statement, serial=serial.to_bytes(16), **changes)


def elsewhere(statement: ThingStatement, serial: int) -> ThingStatement:
    """The same thing at another border router."""
    return again(statement, serial, border=thumbprint(OTHER.public_key))


def row_of(statement: ThingStatement, border: str = BORDER) -> ThingRow:
    """Its row, signed by the authority of the vectors."""
    data = sign_statement(HOME, statement)
    return ThingRow(statement.id, statement.name, border, data, statement.not_before, statement.expires)


def add_thing(store: Store, statement: ThingStatement, *, border: str = BORDER, at: int = NOW) -> None:
    """Record a statement."""
    store.things.add(row_of(statement, border), statement, at)
