"""Presented grants and revocations, with statements signed by an authority."""

import dataclasses

import pytest

from ca.errors import Revoked
from ca.revocation.lists import RevocationList, sign_list
from grants.document import grant_id
from grants.model import Right
from rossec.master.rights.access_rules import require
from rossec.master.rights.caller import Refused
from rossec.master.rights.held_grants import FAILURE_WINDOW, MAX_FAILURES, MAX_HELD
from rossec.master.rights.statements import TrustState
from tests.rossec.master.rights.trust_world import World
from tests.support.authority import DAY, Site


def test_without_a_list_no_grant_is_valid() -> None:
    world = World()
    world.present(world.site.grant(world.node, {"/t": Right.PUBLISH}))
    assert not world.may(Right.PUBLISH, "/t")
    assert world.trust.current(world.now) == (b"", b"")
    world.trust.update(world.site.revoke(), world.now)
    assert world.may(Right.PUBLISH, "/t")


def test_a_grant_is_valid_for_its_rights_and_its_time(world: World) -> None:
    assert not world.may(Right.PUBLISH, "/t")
    assert world.present(world.site.grant(world.node, {"/t": Right.PUBLISH}, lifetime=60)) == (1, ())
    assert world.may(Right.PUBLISH, "/t")
    assert not world.may(Right.SUBSCRIBE, "/t")
    assert not world.may(Right.PUBLISH, "/u")
    assert not world.may(Right.PUBLISH, "/t", later=60)


def test_a_refusal_names_what_is_missing(world: World) -> None:
    with pytest.raises(Refused, match="no grant for publish on /t"):
        require(world.trust.caller(world.node.identity, world.now), Right.PUBLISH, "/t")


def test_refused_grants_do_not_affect_valid_ones(world: World) -> None:
    other = Site()
    world.site.domain = "office"  # the same authority serves two domains
    elsewhere = world.site.grant(world.node, {"/t": Right.PUBLISH})
    world.site.domain = "home"
    held, refused = world.present(
        world.site.grant(world.master, {"/t": Right.PUBLISH}),
        other.grant(world.node, {"/t": Right.PUBLISH}),
        world.site.grant(world.node, {"/t": Right.PUBLISH}, start=-2 * DAY),
        b"garbage",
        elsewhere,
        world.site.grant(world.node, {"/u": Right.PUBLISH}),
    )
    assert held == 1
    assert len(refused) == 5
    assert "office" in refused[4]
    assert "another key" in refused[0]
    assert world.may(Right.PUBLISH, "/u")
    assert not world.may(Right.PUBLISH, "/t")


def test_grants_are_bounded_and_not_counted_twice(world: World) -> None:
    tokens = [world.site.grant(world.node, {f"/t{n}": Right.CALL}) for n in range(MAX_HELD + 1)]
    assert world.present(*tokens[:MAX_HELD], *tokens[:MAX_HELD]) == (MAX_HELD, ())
    held, refused = world.present(tokens[-1])
    assert held == MAX_HELD
    assert "at most" in refused[0]


def test_failed_verifications_are_limited(world: World) -> None:
    good = world.site.grant(world.node, {"/t": Right.PUBLISH})
    held = world.site.grant(world.node, {"/u": Right.PUBLISH})
    world.present(held)
    assert world.present(*[b"garbage"] * MAX_FAILURES)[0] == 1
    assert world.present(good) == (1, ("too many grants of this node were refused",))
    assert world.present(held) == (1, ())
    world.now += FAILURE_WINDOW
    assert world.present(good) == (2, ())


def test_a_revoked_grant_ends_at_once(world: World) -> None:
    token = world.site.grant(world.node, {"/t": Right.PUBLISH})
    world.present(token)
    assert world.trust.update(world.site.revoke(token), world.now)
    assert not world.may(Right.PUBLISH, "/t")


def test_a_list_updated_elsewhere_takes_effect_at_once() -> None:
    site = Site()
    node, revocations = site.enroll("/node"), site.revocations()
    trust = TrustState(site.anchor, site.enroll("/master").credentials.signer, revocations, lambda _: None)
    token = site.grant(node, {"/t": Right.PUBLISH})
    revocations.update(site.revoke(), site.now)
    trust.present(trust.caller(node.identity, site.now), [token], site.now)
    before = trust.caller(node.identity, site.now)
    assert before.may(Right.PUBLISH, "/t")
    assert trust.caller(node.identity, site.now) is before
    revocations.update(site.revoke(token), site.now)
    assert not trust.caller(node.identity, site.now).may(Right.PUBLISH, "/t")
    assert not trust.caller(node.identity, site.now + 1).may(Right.PUBLISH, "/t")


def test_a_revoked_key_has_no_caller(world: World) -> None:
    world.present(world.site.grant(world.node, {"/t": Right.PUBLISH}))
    assert world.trust.caller_of(world.node, world.now) is not None
    world.trust.update(world.site.revoke(world.node), world.now)
    with pytest.raises(Revoked, match="the key of /node is revoked"):
        world.trust.caller(world.node.identity, world.now)
    assert world.trust.caller_of(world.node, world.now) is None


def test_a_key_below_a_revoked_intermediate_is_revoked(world: World) -> None:
    above = b"i" * 32
    member = dataclasses.replace(
        world.node, identity=dataclasses.replace(world.node.identity, issuers=(above,))
    )
    assert world.trust.caller(member.identity, world.now).name == "/node"
    assert world.trust.caller_of(member, world.now) is not None
    listed = RevocationList(1, 7, world.now, world.now + 1000, frozenset({above}))
    world.trust.update(sign_list(world.site.signer, listed), world.now)
    with pytest.raises(Revoked, match="the key of /node is revoked"):
        world.trust.caller(member.identity, world.now)
    assert world.trust.caller_of(member, world.now) is None
    world.trust.keep_only(frozenset(), world.now)
    assert world.trust._identity_keys == {}


def test_two_keys_of_one_name_are_two_callers(world: World) -> None:
    world.present(world.site.grant(world.node, {"/t": Right.PUBLISH}))
    older = world.site.enroll("/node")
    assert not world.trust.caller(older.identity, world.now).may(Right.PUBLISH, "/t")
    node = world.trust.caller_of(world.node, world.now)
    assert node is not None
    assert node.may(Right.PUBLISH, "/t")


def test_an_expired_list_ends_every_right_but_no_connection(world: World) -> None:
    world.trust.update(world.site.revoke(lifetime=60), world.now)
    world.present(world.site.grant(world.node, {"/t": Right.PUBLISH}))
    assert world.may(Right.PUBLISH, "/t", later=59)
    assert not world.may(Right.PUBLISH, "/t", later=60)


def test_other_keys_are_discarded(world: World) -> None:
    world.present(world.site.grant(world.node, {"/t": Right.PUBLISH}))
    world.trust.keep_only(frozenset({world.node.thumbprint}), world.now)
    assert world.may(Right.PUBLISH, "/t")
    world.trust.keep_only(frozenset(), world.now)
    assert not world.may(Right.PUBLISH, "/t")


def test_a_caller_has_the_names_of_its_certificate(world: World) -> None:
    assert not world.trust.caller(world.node.identity, world.now).wildcard
    rviz = world.site.enroll("/rviz", wildcard=True)
    assert world.trust.caller(rviz.identity, world.now).acting_as("/rviz_1").thumbprint == rviz.thumbprint
    registered = world.trust.caller_of(rviz, world.now)
    assert registered is not None
    assert not registered.wildcard  # a name in the registry has no wildcard


def test_a_caller_is_the_authority_by_its_certificate(world: World) -> None:
    own, below = world.site.enroll("/ca"), b"i" * 32
    assert world.trust.caller(own.identity, world.now).is_authority
    assert not world.trust.caller(world.node.identity, world.now).is_authority
    impostor = dataclasses.replace(own.identity, issuers=(below,))
    assert not world.trust.caller(impostor, world.now).is_authority
    assert world.trust.caller(own.identity, world.now).is_authority, "nothing is remembered"


def test_what_a_key_has_presented_is_known(world: World) -> None:
    data = world.site.grant(world.node, {"/p": Right.PUBLISH})
    holder, entry = world.node.thumbprint, grant_id(data)
    assert not world.trust.has_presented(holder, entry)
    world.present(data)
    assert world.trust.has_presented(holder, entry)
    assert not world.trust.has_presented(world.master.thumbprint, entry)
