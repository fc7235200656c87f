"""What the authority does about things: signed, recorded and listed together, or nothing is."""

from dataclasses import replace
from pathlib import Path

import pytest

from ca.errors import StoreError, ThingRefused
from ca.things import ThingSecret, open_statement
from rossec.authority import signing
from rossec.authority.service import ThingOrder
from rossec.authority.signing import required_entries
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from rossec.saved_statements import ThingFiles
from tests.support import refusal_texts
from tests.support.thingoffice import ATTIC, BORDER, DAY, LAMP, Office


@pytest.fixture
def office(tmp_path: Path) -> Office:
    return Office(tmp_path)


def test_a_thing_is_stated_for_one_border_router(office: Office) -> None:
    signed = office.sign()
    key = office.home.anchor().public_key
    found = open_statement(signed.data, key, office.now, domain="home")
    assert found == signed.statement
    assert (found.name, found.border) == (LAMP, office.thumbprint(BORDER))
    assert found.expires == office.now + DAY
    assert (signed.bundle, signed.revoked) == (b"", 0)
    assert [(each.row.name, each.state) for each in office.service.things.states()] == [
        (LAMP, signing.IN_FORCE)
    ]
    office.service.unlock().store.log.audit(key)


def test_it_is_installed_where_its_router_is_here(office: Office, tmp_path: Path) -> None:
    node = NodeHome.of(tmp_path, LAMP)
    node.create_request("home")
    signed = office.sign(request=node.request(), identity_lifetime=DAY)
    path = office.service.things.store(signed.data, signed.bundle)
    files = ThingFiles(NodeHome.of(tmp_path, BORDER))
    assert path == files.path
    assert files.load().statements == {LAMP: signed.statement}
    assert node.identity(office.now).name == LAMP
    elsewhere = office.enroll("/shed")
    elsewhere.path.rename(tmp_path / "gone")
    fan = office.sign(name="/things/fan", border="/shed", credential=office.key(b"1"))
    assert office.service.things.store(fan.data) is None


def test_identity_and_statement_are_one_step(office: Office) -> None:
    office.sign()
    with pytest.raises(StoreError, match=refusal_texts.THING_CHANGED):
        office.sign(credential=office.key(b"\x01"), request=office.request(), identity_lifetime=DAY)
    with pytest.raises(StoreError, match="/things/lamp has no valid identity"):
        office.thumbprint(LAMP)
    with pytest.raises(ConfigurationError, match="of /things/fan, not of /things/lamp"):
        office.sign(request=office.request("/things/fan"), identity_lifetime=DAY)


def test_a_thing_that_was_renamed(office: Office) -> None:
    former = office.sign(request=office.request(), identity_lifetime=DAY)
    node = office.thumbprint(LAMP)
    with pytest.raises(StoreError, match="this key is that of /things/lamp"):
        office.sign(name="/things/light")
    renamed = office.sign(name="/things/light", replaced=frozenset({LAMP}))
    assert renamed.revoked == 2
    assert office.revoked() == {former.statement.id, node}
    states = [(each.row.name, each.state) for each in office.service.things.states()]
    assert states == [(LAMP, "revoked"), ("/things/light", "in force")]


def test_a_thing_at_another_router(office: Office) -> None:
    former = office.sign(request=office.request(), identity_lifetime=DAY)
    node = office.thumbprint(LAMP)
    with pytest.raises(StoreError, match="with another border router"):
        office.sign(border=ATTIC)
    moved = office.sign(
        border=ATTIC, replaced=frozenset({LAMP}), request=office.request(), identity_lifetime=DAY
    )
    assert office.revoked() == {former.statement.id, node}
    assert office.thumbprint(LAMP) != node
    assert moved.statement.border == office.thumbprint(ATTIC)


def test_another_device_takes_the_place_of_one(office: Office) -> None:
    former = office.sign(request=office.request(), identity_lifetime=DAY)
    node = office.thumbprint(LAMP)
    office.sign(credential=office.key(b"\x01"), replaced=frozenset({LAMP}))
    assert office.revoked() == {former.statement.id}
    assert office.thumbprint(LAMP) == node


def test_there_must_be_something_to_replace(office: Office) -> None:
    with pytest.raises(StoreError, match="no statement about /things/lamp is in force"):
        office.sign(replaced=frozenset({LAMP}))


def test_a_renewal_states_the_same_again(office: Office) -> None:
    office.sign()
    office.now += DAY // 2
    renewed = office.service.things.renew(LAMP, 2 * DAY)
    assert renewed.statement.expires == office.now + 2 * DAY
    assert renewed.revoked == 0
    states = [each.state for each in office.service.things.states()]
    assert states == [signing.RENEWED, signing.IN_FORCE]
    office.now += 3 * DAY
    assert office.service.things.states()[-1].state == signing.EXPIRED
    again = office.service.things.renew(LAMP, DAY)
    assert again.statement.credential == office.order.credential
    with pytest.raises(StoreError, match=refusal_texts.THING_UNKNOWN):
        office.service.things.renew("/things/fan", DAY)


def test_a_revoked_thing(office: Office) -> None:
    first = office.sign()
    second = office.service.things.renew(LAMP, DAY)
    listed, count = office.service.things.revoke(LAMP, "lost")
    assert count == 2
    assert listed.entries == {first.statement.id, second.statement.id}
    with pytest.raises(StoreError, match=refusal_texts.THING_UNKNOWN):
        office.service.things.revoke(LAMP, "again")
    with pytest.raises(StoreError, match=refusal_texts.THING_UNKNOWN):
        office.service.things.renew(LAMP, DAY)
    office.sign()
    store = office.service.unlock().store
    assert required_entries(store, office.now + DAY + 120) == frozenset()


def test_a_revoked_node_of_a_thing_takes_its_statement_along(office: Office) -> None:
    signed = office.sign(request=office.request(), identity_lifetime=DAY)
    node = office.thumbprint(LAMP)
    listed, count = office.service.identities.revoke(LAMP, "lost")
    assert (set(listed.entries), count) == ({signed.statement.id, node}, 1)


def test_a_revoked_router_takes_its_things_along(office: Office) -> None:
    lamp = office.sign(request=office.request(), identity_lifetime=DAY)
    fan = office.sign(name="/things/fan", border=ATTIC, credential=office.key(b"1"))
    keys = {office.thumbprint(name) for name in (LAMP, BORDER)}
    listed, count = office.service.identities.revoke(BORDER, "stolen")
    assert (set(listed.entries), count) == (keys | {lamp.statement.id}, 1)
    assert fan.statement.id not in listed.entries
    with pytest.raises(StoreError, match="the identity of /border is revoked"):
        office.sign(name="/things/tap", credential=office.key(b"2"))


def test_a_moved_thing_does_not_end_with_its_former_router(office: Office) -> None:
    office.sign()
    moved = office.sign(
        border=ATTIC, replaced=frozenset({LAMP}), request=office.request(), identity_lifetime=DAY
    )
    listed, _ = office.service.identities.revoke(BORDER, "stolen")
    assert not listed.entries & {moved.statement.id, office.thumbprint(LAMP)}


def test_a_router_that_was_set_up_anew(office: Office) -> None:
    """Whoever has the former key has those of the things' nodes as well."""
    signed = office.sign(request=office.request(), identity_lifetime=DAY)
    node = office.thumbprint(LAMP)
    office.enroll(BORDER, replaced=BORDER)
    assert {signed.statement.id, node} < office.revoked()
    with pytest.raises(StoreError, match="there is no thing"):
        office.service.things.renew(LAMP, DAY)
    assert office.sign().statement.border == office.thumbprint(BORDER)


def test_a_secret_is_stated_by_its_thumbprint(office: Office) -> None:
    secret = ThingSecret.of(bytes(16), b"\x01")
    signed = office.sign(credential=secret)
    assert signed.statement.credential == secret
    with pytest.raises(StoreError, match="this key is that of /things/lamp"):
        office.sign(name="/things/fan", credential=replace(secret, kid=b"\x02"))


def test_what_cannot_be_stated(office: Office) -> None:
    with pytest.raises(ThingRefused, match="/master cannot be the name of a thing"):
        office.sign(name="/master")
    with pytest.raises(StoreError, match="/nobody has no valid identity"):
        office.sign(border="/nobody")
    office.service.unlock().revoke(office.order.credential.thumbprint, "leaked", office.now)
    with pytest.raises(StoreError, match="the key of /things/lamp is revoked"):
        office.sign()


def test_an_intermediate_says_nothing_about_things(office: Office, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(type(office.service.unlock().authority), "is_root", property(lambda _: 0))
    with pytest.raises(ConfigurationError, match="an intermediate cannot say what a thing is"):
        office.service.things.sign(ThingOrder(LAMP, BORDER, office.key(b"1"), DAY))
