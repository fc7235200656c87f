"""Grants presented and revocations held: real statements of a real authority."""

import dataclasses

import pytest

from ca.errors import RevocationRefused, Revoked
from ca.revocation import RevocationList, digest, open_timestamp, sign_list
from ca.signer import KeySigner
from grants.errors import GrantError
from grants.model import Right
from rossec.master.trust import FAILURES_WITHIN, MAX_FAILURES, MAX_HELD, Trust
from tests.support.authority import DAY, Site


class World:
    def __init__(self) -> None:
        self.site = Site()
        self.now = self.site.now
        self.master = self.site.enroll("/master")
        self.node = self.site.enroll("/node")
        self.persisted: list[bytes] = []
        self.trust = Trust(
            self.site.anchor,
            self.master.credentials.signer,
            self.site.revocations(),
            self.persisted.append,
        )

    def may(self, right: Right, name: str, later: int = 0) -> bool:
        return self.trust.caller(self.node, self.now + later).may(right, name)

    def present(self, *tokens: bytes) -> tuple[int, tuple[str, ...]]:
        return self.trust.present(self.trust.caller(self.node, self.now), tokens, self.now)


@pytest.fixture
def world() -> World:
    world = World()
    assert world.trust.update(world.site.revoke(), world.now)
    return world


def test_without_a_list_nobody_may_anything() -> None:
    world = World()
    world.present(world.site.grant(world.node, {"/t": Right.PUBLISH}))
    assert not world.may(Right.PUBLISH, "/t")
    assert world.trust.current(world.now) == (b"", b"")
    world.trust.update(world.site.revoke(), world.now)
    assert world.may(Right.PUBLISH, "/t")


def test_a_grant_holds_for_what_it_says_and_as_long(world: World) -> None:
    assert not world.may(Right.PUBLISH, "/t")
    assert world.present(world.site.grant(world.node, {"/t": Right.PUBLISH}, lifetime=60)) == (
        1,
        (),
    )
    assert world.may(Right.PUBLISH, "/t")
    assert not world.may(Right.SUBSCRIBE, "/t")
    assert not world.may(Right.PUBLISH, "/u")
    assert not world.may(Right.PUBLISH, "/t", later=60)


def test_a_refusal_names_what_is_missing(world: World) -> None:
    with pytest.raises(GrantError, match="no grant for publish on /t"):
        world.trust.caller(world.node, world.now).access.require(Right.PUBLISH, "/t")


def test_bad_grants_do_not_spoil_good_ones(world: World) -> None:
    stranger = Site()
    world.site.domain = "office"  # the same authority serves two domains
    elsewhere = world.site.grant(world.node, {"/t": Right.PUBLISH})
    world.site.domain = "home"
    held, refused = world.present(
        world.site.grant(world.master, {"/t": Right.PUBLISH}),
        stranger.grant(world.node, {"/t": Right.PUBLISH}),
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


def test_only_so_many_grants_are_verified_in_vain(world: World) -> None:
    good = world.site.grant(world.node, {"/t": Right.PUBLISH})
    held = world.site.grant(world.node, {"/u": Right.PUBLISH})
    world.present(held)
    assert world.present(*[b"garbage"] * MAX_FAILURES)[0] == 1
    assert world.present(good) == (1, ("too many grants of this node were refused",))
    assert world.present(held) == (1, ())
    world.now += FAILURES_WITHIN
    assert world.present(good) == (2, ())


def test_a_revoked_grant_ends_at_once(world: World) -> None:
    token = world.site.grant(world.node, {"/t": Right.PUBLISH})
    world.present(token)
    assert world.trust.update(world.site.revoke(token), world.now)
    assert not world.may(Right.PUBLISH, "/t")


def test_a_revoked_key_is_nobody(world: World) -> None:
    world.present(world.site.grant(world.node, {"/t": Right.PUBLISH}))
    assert world.trust.caller_of(world.node, world.now) is not None
    world.trust.update(world.site.revoke(world.node), world.now)
    with pytest.raises(Revoked, match="the key of /node is revoked"):
        world.trust.caller(world.node, world.now)
    assert world.trust.caller_of(world.node, world.now) is None


def test_a_key_below_a_revoked_intermediate_is_nobody(world: World) -> None:
    above = b"i" * 32
    member = dataclasses.replace(
        world.node, identity=dataclasses.replace(world.node.identity, issuers=(above,))
    )
    assert world.trust.caller(member, world.now).name == "/node"
    assert world.trust.caller_of(member, world.now) is not None
    listed = RevocationList(1, 7, world.now, world.now + 1000, frozenset({above}))
    world.trust.update(sign_list(world.site.signer, listed), world.now)
    with pytest.raises(Revoked, match="the key of /node is revoked"):
        world.trust.caller(member, world.now)
    assert world.trust.caller_of(member, world.now) is None
    world.trust.keep_only(frozenset(), world.now)
    assert world.trust._chains == {}


def test_two_keys_of_one_name_are_two_callers(world: World) -> None:
    world.present(world.site.grant(world.node, {"/t": Right.PUBLISH}))
    older = world.site.enroll("/node")
    assert not world.trust.caller(older, world.now).may(Right.PUBLISH, "/t")
    node = world.trust.caller_of(world.node, world.now)
    assert node is not None
    assert node.may(Right.PUBLISH, "/t")


def test_lists_are_persisted_first_and_only_newer_ones_taken(world: World) -> None:
    old, new = world.site.revoke(), world.site.revoke(world.master)
    assert world.trust.update(new, world.now)
    assert world.persisted[-1] == new
    assert not world.trust.update(new, world.now)
    for bad in (old, Site().revoke(), b"garbage"):
        with pytest.raises(RevocationRefused):
            world.trust.update(bad, world.now)
    assert world.persisted[-1] == new


def test_a_list_that_cannot_be_persisted_is_not_used(world: World) -> None:
    def full(_: bytes) -> None:
        raise OSError("disk full")

    world.trust._persist = full
    with pytest.raises(OSError, match="disk full"):
        world.trust.update(world.site.revoke(world.node), world.now)
    assert world.trust.caller(world.node, world.now).name == "/node"


def test_the_timestamp_is_the_masters_and_of_now(world: World) -> None:
    data, stamp = world.trust.current(world.now + 7)
    signer = world.master.credentials.signer
    assert isinstance(signer, KeySigner)
    opened = open_timestamp(stamp, signer.public_key)
    assert (opened.issued, opened.digest) == (world.now + 7, digest(data))
    assert world.trust.current(world.now + 7)[1] == stamp
    assert world.trust.current(world.now + 8)[1] != stamp


def test_an_expired_list_ends_every_right_but_no_connection(world: World) -> None:
    world.trust.update(world.site.revoke(lifetime=60), world.now)
    world.present(world.site.grant(world.node, {"/t": Right.PUBLISH}))
    assert world.may(Right.PUBLISH, "/t", later=59)
    assert not world.may(Right.PUBLISH, "/t", later=60)


def test_forgetting(world: World) -> None:
    world.present(world.site.grant(world.node, {"/t": Right.PUBLISH}))
    world.trust.keep_only(frozenset({world.node.thumbprint}), world.now)
    assert world.may(Right.PUBLISH, "/t")
    world.trust.keep_only(frozenset(), world.now)
    assert not world.may(Right.PUBLISH, "/t")


def test_a_caller_is_what_its_certificate_says(world: World) -> None:
    assert not world.trust.caller(world.node, world.now).wildcard
    rviz = world.site.enroll("/rviz", wildcard=True)
    assert world.trust.caller(rviz, world.now).acting_as("/rviz_1").thumbprint == rviz.thumbprint
    registered = world.trust.caller_of(rviz, world.now)
    assert registered is not None
    assert not registered.wildcard  # a name in the registry is that name alone
