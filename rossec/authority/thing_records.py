"""What the record says of things, as the authority's decisions need it.

A border router has the keys of the nodes that stand for its things. So where a router, or the node
of a thing, loses its key, what depended on it ends in the same list.
"""

from typing import Final, NamedTuple

from ca.errors import ThingUnknown
from ca.store.record import Store
from ca.store.things import ThingRow

IN_FORCE: Final = "in force"
RENEWED: Final = "renewed"
EXPIRED: Final = "expired"
REVOKED: Final = "revoked"
OTHER_KEY: Final = "its border router has another key"


class ThingState(NamedTuple):
    """A statement, and what it is now: in force, renewed, expired, revoked, or of a former key."""

    row: ThingRow
    state: str


def states(store: Store, now: int) -> list[ThingState]:
    """Every statement, oldest first, with what it is at `now`."""
    with store.database.read_transaction():
        rows, revoked = store.things.all(), store.revoked_entries()
        newest = {row.name: row.id for row in store.things.in_force(now)}
        borders = {row.border for row in rows}
        keys = {name: _newest_key(store, name, now) for name in borders}
    return [ThingState(row, _state(row, now, newest, revoked, keys)) for row in rows]


def _newest_key(store: Store, name: str, now: int) -> bytes:
    """The thumbprint of the newest valid key of a node; empty: it has none."""
    valid = store.identities.valid(name, now)
    return valid[-1].thumbprint if valid else b""


def _state(
    row: ThingRow, now: int, newest: dict[str, bytes], revoked: frozenset[bytes],
    keys: dict[str, bytes],
) -> str:  # fmt: skip
    if row.id in revoked:
        return REVOKED
    if now >= row.expires:
        return EXPIRED
    if newest[row.name] != row.id:
        return RENEWED
    return IN_FORCE if row.read().border == keys[row.border] else OTHER_KEY


def ended_with(store: Store, name: str, now: int) -> frozenset[bytes]:
    """What must be revoked with the keys of the node `name`, besides these.

    The statements about it, if it is a thing, and what ends with a border router of that name.
    """
    about = (row.id for row in _not_revoked(store) if row.name == name)
    return ended_with_router(store, name, now) | frozenset(about)


def ended_with_router(store: Store, border: str, now: int) -> frozenset[bytes]:
    """What must be revoked with a key of the border router `border`.

    The statements about its things, expired or not, and the keys of their nodes, which it has.
    """
    alive = [row for row in _not_revoked(store) if row.border == border]
    entries = {row.id for row in alive}
    for thing in {row.name for row in alive}:
        if store.things.last(thing).border == border:
            entries |= store.unrevoked_keys(thing, now)
    return frozenset(entries)


def end_with_router(store: Store, border: str, now: int) -> None:
    """Record the end of what `ended_with_router` names: the router `border` has a new key."""
    for entry in sorted(ended_with_router(store, border, now)):
        store.revoke(entry, f"{border} has a new key", now)


def _not_revoked(store: Store) -> list[ThingRow]:
    revoked = store.revoked_entries()
    return [row for row in store.things.all() if row.id not in revoked]


def replaced_by(
    store: Store, name: str, border: bytes, replaced: frozenset[str], now: int
) -> frozenset[bytes]:
    """What ends where a statement about `name` at the router with the key `border` is signed.

    For each thing that it replaces: the statements in force, and the keys of its node where that
    node has to be another one, under the new name or at another router.

    Raises:
        ThingUnknown: there is nothing about one of them to replace.
    """
    entries: set[bytes] = set()
    for former in sorted(replaced):
        ids = store.things.ids(former, now)
        if not ids:
            raise ThingUnknown(f"no statement about {former} is in force", "leave --replace out")
        entries |= ids
        if former != name or store.things.get(former, now).read().border != border:
            entries |= store.unrevoked_keys(former, now)
    return frozenset(entries)
