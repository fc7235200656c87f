"""What the audit finds in statements about things that were rewritten, log and all."""

from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import pytest

from ca.errors import LogDamaged
from ca.keys.signing import Profile, thumbprint
from ca.store.database import append_entry
from ca.store.record import Store
from ca.store.signed_statements import ThingRow
from ca.store.values import digest_of
from ca.things import sign_statement
from tests.support.things import FAN, LAMP, add_thing, again, row_of
from tests.vectors.make_things import HOME, NOW, OTHER


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    with closing(Store.create(tmp_path / "ca.db")) as made:
        yield made


def write(store: Store, row: ThingRow) -> None:
    """As somebody does who can write the file, and knows the log."""
    with store.database.transaction() as db:
        db.execute("INSERT INTO thing VALUES (?, ?, ?, ?, ?, ?, ?)", (*row, NOW))
        append_entry(db, NOW, "thing", row.name, row.id.hex(), digest_of(row))


def test_what_was_done_in_order_passes(store: Store) -> None:
    add_thing(store, LAMP)
    add_thing(store, again(LAMP, 2))
    for number in (LAMP.id, again(LAMP, 2).id):
        store.revoke(number, "renamed", NOW)
    add_thing(store, again(LAMP, 3, name="/things/light", expires=NOW + 5))
    add_thing(store, again(LAMP, 4), at=NOW + 5)
    add_thing(store, FAN, at=NOW + 5)
    store.log.audit(HOME.public_key)


def by_another_key(store: Store) -> None:
    row = row_of(FAN)
    write(store, row._replace(data=sign_statement(OTHER, FAN)))


def of_another_kind(store: Store) -> None:
    data = Profile("rossec-grant+cwt").sign(HOME, {1: 1})
    write(store, row_of(FAN)._replace(data=data))


def another_id(store: Store) -> None:
    write(store, row_of(FAN)._replace(id=bytes(16)))


def another_name(store: Store) -> None:
    write(store, row_of(FAN)._replace(name="/things/door"))


def another_time(store: Store) -> None:
    write(store, row_of(FAN)._replace(expires=FAN.expires + 1))


def a_second_name_for_a_key(store: Store) -> None:
    write(store, row_of(again(LAMP, 2, name="/things/door")))


def a_second_router_for_a_name(store: Store) -> None:
    write(store, row_of(again(LAMP, 2, border=thumbprint(OTHER.public_key))))


@pytest.mark.parametrize(
    "change",
    [
        by_another_key,
        of_another_kind,
        another_id,
        another_name,
        another_time,
        a_second_name_for_a_key,
        a_second_router_for_a_name,
    ],
)
def test_what_could_not_have_been_signed_is_found(store: Store, change: Callable[[Store], None]) -> None:
    add_thing(store, LAMP)
    change(store)
    with pytest.raises(LogDamaged, match="log entry 1") as caught:
        store.log.audit(HOME.public_key)
    assert "restore a backup" in caught.value.hint


def test_a_row_that_was_changed_is_found(store: Store) -> None:
    add_thing(store, LAMP)
    store.database.connection.execute("DROP TRIGGER thing_no_UPDATE")
    store.database.connection.execute("UPDATE thing SET border = '/attic'")
    with pytest.raises(LogDamaged, match="thing of log entry 0 is missing or was changed"):
        store.log.audit(HOME.public_key)
