"""Grants that the master has renewed count as presented, and end with the delegation."""

import pytest

from grants.model import Right
from grants.renewal import open_delegation
from rossec.master.rights.held_grants import MAX_FAILURES, MAX_HELD
from tests.rossec.master.rights.trust_world import World, update_delegation
from tests.support.authority import DAY


def renew(world: World, *tokens: bytes) -> tuple[tuple[bytes, ...], tuple[str, ...]]:
    return world.trust.renew(world.trust.caller(world.node.identity, world.now), tokens, world.now)


def test_a_renewed_grant_counts_at_once_and_when_it_is_presented(world: World) -> None:
    data = world.site.grant(world.node, {"/t": Right.PUBLISH}, lifetime=60, cap=DAY)
    world.present(data)
    (token,), refused = renew(update_delegation(world), data)
    assert refused == ()
    assert world.may(Right.PUBLISH, "/t", later=61)
    assert world.present(data, token) == (1, ())
    assert world.may(Right.PUBLISH, "/t", later=61)
    world.trust.keep_only(frozenset(), world.now)
    assert not world.may(Right.PUBLISH, "/t", later=61)
    assert world.present(token) == (1, ())
    assert world.may(Right.PUBLISH, "/t", later=61)
    world.trust.update(world.site.revoke(data), world.now)
    assert not world.may(Right.PUBLISH, "/t")
    assert renew(world, token)[0] == (b"",)


@pytest.mark.parametrize("which", ["delegation", "delegate"])
def test_a_renewed_grant_ends_with_the_delegation(world: World, which: str) -> None:
    data = world.site.grant(world.node, {"/t": Right.PUBLISH}, lifetime=60, cap=DAY)
    delegation = world.site.delegation(world.master)
    assert world.trust.update_delegation(delegation)
    renew(world, data)
    assert world.may(Right.PUBLISH, "/t")
    opened = open_delegation(delegation, world.site.anchor.public_key)
    revoked = opened.id if which == "delegation" else opened.holder
    world.trust.update(world.site.revoke(revoked), world.now)
    assert not world.may(Right.PUBLISH, "/t")


def test_a_grant_that_is_not_renewed_does_not_affect_the_others(world: World) -> None:
    good = world.site.grant(world.node, {"/t": Right.PUBLISH}, lifetime=60, cap=DAY)
    tokens, refused = renew(update_delegation(world), b"garbage", good)
    assert (tokens[0], len(refused)) == (b"", 1)
    assert tokens[1] != b""
    renew(world, *[b"garbage"] * MAX_FAILURES)
    assert renew(world, good)[1] == ("too many grants of this node were refused",)


def test_a_renewed_grant_beyond_the_limits_is_not_stored(world: World) -> None:
    tokens = [world.site.grant(world.node, {f"/t{n}": Right.CALL}) for n in range(MAX_HELD)]
    world.present(*tokens)
    (token,), _ = renew(
        update_delegation(world), world.site.grant(world.node, {"/t": Right.PUBLISH}, lifetime=60, cap=DAY)
    )
    assert token
    assert not world.may(Right.PUBLISH, "/t")
