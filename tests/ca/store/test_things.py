"""One name is one thing, one key is one thing, and one kid at one border router."""

from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest

from ca.errors import StoreError
from ca.store.record import Store
from ca.store.signed_statements import check_things_apart
from ca.things import ThingKey, ThingSecret, ThingStatement
from tests.support.things import FAN, LAMP, add_thing, again, elsewhere
from tests.vectors.make_things import NOW, OTHER, SECRET


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    with closing(Store.create(tmp_path / "ca.db")) as made:
        yield made


def test_a_statement_is_recorded_and_in_the_log(store: Store) -> None:
    add_thing(store, LAMP)
    add_thing(store, FAN)
    assert store.things.get(LAMP.name, NOW).read() == LAMP
    assert [row.name for row in store.things.all()] == [LAMP.name, FAN.name]
    assert store.things.newest(NOW).keys() == {LAMP.name, FAN.name}
    assert [(e.what, e.subject, e.detail) for e in store.log.entries()] == [
        ("thing", LAMP.name, LAMP.id.hex()),
        ("thing", FAN.name, FAN.id.hex()),
    ]
    with pytest.raises(StoreError):
        add_thing(store, LAMP)


def test_a_renewal_ends_nothing(store: Store) -> None:
    later = again(LAMP, 2, not_before=NOW + 5)
    add_thing(store, LAMP)
    add_thing(store, later)
    assert store.things.get(LAMP.name, NOW).read() == later
    assert store.things.ids(LAMP.name, NOW) == {LAMP.id, later.id}


def test_a_statement_ends_with_its_time_or_by_revocation(store: Store) -> None:
    short = again(LAMP, 2, expires=NOW + 9)
    add_thing(store, short)
    assert store.things.newest(NOW + 8) == {LAMP.name: row_of_data(store)}
    assert store.things.newest(NOW + 9) == {}
    with pytest.raises(StoreError, match="no statement about a thing /things/lamp is in force"):
        store.things.get(LAMP.name, NOW + 9)
    assert store.things.last(LAMP.name).id == short.id
    store.revoke(short.id, "lost", NOW)
    assert store.things.newest(NOW) == {}
    assert [row.id for row in store.things.revoked()] == [short.id]
    with pytest.raises(StoreError, match="there is no thing /things/lamp") as caught:
        store.things.last(LAMP.name)
    assert "rossec ca things" in caught.value.hint


def row_of_data(store: Store) -> object:
    return store.things.all()[-1]


@pytest.mark.parametrize(
    ("new", "message", "hint"),
    [
        (replace(FAN, name=LAMP.name), "in force with another key", "--replace /things/lamp"),
        (elsewhere(LAMP, 3), "in force with another border router", "--replace /things/lamp"),
        (
            again(LAMP, 3, name="/things/light"),
            "this key is that of /things/lamp",
            "renamed: --replace /things/lamp",
        ),
        (
            replace(FAN, credential=replace(LAMP.credential, kid=b"\x99"), serial=b"k" * 16),
            "this key is that of /things/lamp",
            "--replace /things/lamp",
        ),
        (
            replace(FAN, credential=ThingKey.of(OTHER.public_key, LAMP.credential.kid)),
            "/things/lamp has the same kid 2b",
            "another kid",
        ),
        (
            replace(FAN, credential=ThingSecret.of(SECRET, LAMP.credential.kid)),
            "/things/lamp has the same kid 2b",
            "another kid",
        ),
        (
            replace(LAMP, credential=replace(LAMP.credential, kid=b"\x99"), serial=b"k" * 16),
            "another border router",
            "--replace",
        ),
    ],
)
def test_what_must_name_what_it_replaces(store: Store, new: ThingStatement, message: str, hint: str) -> None:
    add_thing(store, LAMP)
    with pytest.raises(StoreError, match=message) as caught:
        add_thing(store, new)
    assert hint in caught.value.hint
    assert store.things.newest(NOW).keys() == {LAMP.name}
    with store.transaction():
        store.revoke(LAMP.id, "replaced", NOW)
        add_thing(store, new)


def test_a_kid_may_be_used_at_each_border_router(store: Store) -> None:
    same_kid = replace(FAN, credential=ThingKey.of(OTHER.public_key, LAMP.credential.kid))
    add_thing(store, LAMP)
    add_thing(store, elsewhere(same_kid, 4), border="/attic")
    check_things_apart(LAMP, elsewhere(same_kid, 4))


def test_what_has_ended_is_in_nobodys_way(store: Store) -> None:
    add_thing(store, LAMP)
    store.revoke(LAMP.id, "renamed", NOW)
    add_thing(store, again(LAMP, 2, name="/things/light", expires=NOW + 1))
    add_thing(store, again(LAMP, 3), at=NOW + 1)
