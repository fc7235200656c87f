"""What ends with what, as the record says it."""

from pathlib import Path

import pytest

from ca.errors import StoreError
from rossec.authority.console.grant_requests import keys_of
from rossec.authority.signing import (
    EXPIRED,
    IN_FORCE,
    OTHER_KEY,
    RENEWED,
    REVOKED,
    end_with_router,
    ended_with,
    ended_with_router,
    replaced_by,
    states,
)
from tests.support.thingoffice import ATTIC, BORDER, DAY, LAMP, Office


@pytest.fixture
def office(tmp_path: Path) -> Office:
    return Office(tmp_path)


def test_the_states_of_statements(office: Office) -> None:
    store = office.service.unlock().store
    assert states(store, office.now) == []
    office.sign()
    office.service.things.renew(LAMP, 3 * DAY)
    fan = office.sign(name="/things/fan", credential=office.key(b"1"))
    store.revoke(fan.statement.id, "lost", office.now)
    assert [each.state for each in states(store, office.now)] == [RENEWED, IN_FORCE, REVOKED]
    assert [each.state for each in states(store, office.now + DAY)] == [EXPIRED, IN_FORCE, REVOKED]
    store.revoke(office.thumbprint(BORDER), "lost", office.now)
    assert [each.state for each in states(store, office.now)][1] == OTHER_KEY


def test_what_ends_with_a_name(office: Office) -> None:
    store = office.service.unlock().store
    lamp = office.sign(request=office.request(), identity_lifetime=DAY).statement.id
    node = office.thumbprint(LAMP)
    assert ended_with(store, "/robot", office.now) == frozenset()
    assert ended_with(store, LAMP, office.now) == {lamp}
    assert ended_with_router(store, LAMP, office.now) == frozenset()
    assert ended_with(store, BORDER, office.now) == {lamp, node}
    assert ended_with_router(store, BORDER, office.now + DAY) == {lamp, node}
    store.revoke(lamp, "lost", office.now)
    assert ended_with(store, LAMP, office.now) == frozenset()


def test_every_way_of_revoking_a_router_ends_its_things(office: Office) -> None:
    store = office.service.unlock().store
    lamp = office.sign(request=office.request(), identity_lifetime=DAY).statement.id
    ended = {lamp, office.thumbprint(LAMP), office.thumbprint(BORDER)}
    assert keys_of(BORDER)(store, office.now) == ended
    assert keys_of(LAMP)(store, office.now) == {lamp, office.thumbprint(LAMP)}
    end_with_router(store, BORDER, office.now)
    assert store.revoked_entries() == ended - {office.thumbprint(BORDER)}


def test_what_is_replaced(office: Office) -> None:
    store = office.service.unlock().store
    lamp = office.sign(request=office.request(), identity_lifetime=DAY).statement
    node = office.thumbprint(LAMP)
    both = frozenset({lamp.id, node})
    only = frozenset({LAMP})
    attic = office.thumbprint(ATTIC)
    assert replaced_by(store, LAMP, lamp.border, only, office.now) == {lamp.id}
    assert replaced_by(store, LAMP, attic, only, office.now) == both
    assert replaced_by(store, "/things/light", lamp.border, only, office.now) == both
    assert replaced_by(store, LAMP, attic, frozenset(), office.now) == frozenset()
    with pytest.raises(StoreError, match="no statement about /things/fan is in force"):
        replaced_by(store, LAMP, attic, frozenset({"/things/fan"}), office.now)
