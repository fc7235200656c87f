"""A grant is the caller's by its key and, for anonymous nodes, by the tail of its certificate."""

from dataclasses import replace

import pytest

from ca.certificates import Identity
from grants.document import peek
from grants.errors import GrantNotHeld
from grants.model import Right
from rossec.master.rights.caller import Refused
from rossec.master.rights.held_grants import check_holder
from tests.rossec.master.rights.trust_world import World, update_delegation
from tests.support.authority import DAY, EnrolledNode

OWN = {"/rviz~/get_loggers": Right.PROVIDE}


@pytest.fixture
def rviz(world: World) -> EnrolledNode:
    return world.site.enroll("/rviz", wildcard=True)


def present(world: World, peer: Identity, token: bytes) -> tuple[int, tuple[str, ...]]:
    return world.trust.present(world.trust.caller(peer, world.now), [token], world.now)


def test_an_anonymous_node_presents_what_its_identity_has(world: World, rviz: EnrolledNode) -> None:
    token = world.site.grant(rviz, OWN)
    assert present(world, rviz.identity, token) == (1, ())
    caller = world.trust.caller(rviz.identity, world.now)
    check_holder(caller, peek(token), "")
    acting = caller.acting_as("/rviz_1_2")
    assert acting.has_tail
    check_holder(acting, peek(token), "")
    assert acting.may(Right.PROVIDE, "/rviz_1_2/get_loggers")
    for name in ("/rviz_/get_loggers", "/rvizx/get_loggers", "/node/get_loggers"):
        assert not acting.may(Right.PROVIDE, name)
        with pytest.raises(Refused):
            caller.acting_as(name.rsplit("/", 1)[0])


def test_without_the_tail_it_counts_for_nothing(world: World, rviz: EnrolledNode) -> None:
    plain = replace(rviz.identity, wildcard=False)
    held, (reason,) = present(world, plain, world.site.grant(rviz, OWN))
    assert held == 0
    assert "anonymous nodes of /rviz" in reason
    assert not world.trust.caller(plain, world.now).may(Right.PROVIDE, "/rviz/get_loggers")


def test_what_was_presented_with_the_tail_ends_without_it(world: World, rviz: EnrolledNode) -> None:
    """Another certificate of the same key: names beside its own may be others' by then."""
    plain = world.site.grant(rviz, {"/a": Right.CALL})
    present(world, rviz.identity, world.site.grant(rviz, OWN))
    present(world, rviz.identity, plain)
    later = world.trust.caller(replace(rviz.identity, wildcard=False), world.now)
    assert not later.may(Right.PROVIDE, "/rviz_1/get_loggers")
    assert later.may(Right.CALL, "/a")
    again = world.trust.caller(rviz.identity, world.now)
    assert not again.may(Right.PROVIDE, "/rviz_1/get_loggers"), "until it is presented again"


def test_without_the_tail_it_is_not_renewed(world: World, rviz: EnrolledNode) -> None:
    update_delegation(world)
    data = world.site.grant(rviz, OWN, lifetime=60, cap=DAY)
    plain = world.trust.caller(replace(rviz.identity, wildcard=False), world.now)
    tokens, (reason,) = world.trust.renew(plain, [data], world.now)
    assert tokens == (b"",)
    assert "anonymous nodes of /rviz" in reason
    whole = world.trust.caller(rviz.identity, world.now)
    tokens, refused = world.trust.renew(whole, [data], world.now)
    assert refused == ()
    assert tokens[0]


def test_a_grant_of_another_key_is_refused(world: World, rviz: EnrolledNode) -> None:
    caller = world.trust.caller(rviz.identity, world.now)
    with pytest.raises(GrantNotHeld, match="another key"):
        check_holder(caller, peek(world.site.grant(world.node, {"/a": Right.CALL})), "")
