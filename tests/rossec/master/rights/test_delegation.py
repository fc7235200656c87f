"""The master renews grants within the authority's delegation only."""

import pytest

from ca.errors import HintedError, Revoked
from ca.revocation.trust_status import SKEW
from grants.document import grant_id, verify
from grants.errors import (
    GrantForged,
    GrantForOther,
    GrantNotHeld,
    GrantRevoked,
    GrantTooWide,
    RenewalNotInTime,
)
from grants.model import Grant, Right
from grants.renewal import open_delegation
from grants.token import unpack
from rossec.master.rights.renewals import TicketSigner
from tests.support.authority import DAY, Site

HOUR = 3600
P = {"/t": Right.PUBLISH}


class World:
    def __init__(self) -> None:
        self.site = Site()
        self.now = self.site.now
        self.master, self.node = self.site.enroll("/master"), self.site.enroll("/node")
        self.persisted: list[bytes] = []
        self.delegate = TicketSigner(self.site.anchor, self.master.credentials.signer, self.persisted.append)
        self.revoked = b""

    def check(self, entry: bytes, _: int) -> None:
        if entry == self.revoked:
            raise Revoked("on the list")

    def renew(self, token: bytes, later: int = 0, holder: bytes = b"") -> tuple[Grant, bytes]:
        return self.delegate.renew(
            token, holder or self.node.thumbprint, self.now + later, seq=3, check=self.check
        )

    def grant(self, lifetime: int = HOUR // 2, cap: int = 10 * HOUR) -> bytes:
        return self.site.grant(self.node, P, lifetime=lifetime, cap=cap)


@pytest.fixture
def world() -> World:
    world = World()
    assert world.delegate.take(world.site.delegation(world.master))
    return world


def test_a_renewed_grant_keeps_its_id_and_rights(world: World) -> None:
    data = world.grant()
    grant, token = world.renew(data)
    assert unpack(token).grant == data
    original = verify(data, world.site.anchor.public_key)
    assert (grant.id, grant.permissions) == (original.id, original.permissions)
    assert grant.expires == world.now - SKEW + HOUR
    assert grant.via[0] == world.delegate.id


def test_expired_and_renewed_grants_are_renewed(world: World) -> None:
    data = world.grant()
    _, token = world.renew(data, later=3 * HOUR)
    again, _ = world.renew(token, later=9 * HOUR + HOUR // 2)
    assert again.expires == verify(data, world.site.anchor.public_key).cap


def test_a_ticket_expires_with_the_delegation() -> None:
    world = World()
    world.delegate.take(world.site.delegation(world.master, lifetime=2 * HOUR))
    grant, _ = world.renew(world.grant(), later=HOUR + HOUR // 2)
    assert grant.expires == world.now - 60 + 2 * HOUR
    with pytest.raises(RenewalNotInTime, match="the delegation expired"):
        world.renew(world.grant(), later=2 * HOUR)


@pytest.mark.parametrize(
    ("lifetime", "cap", "later", "refusal", "message"),
    [
        (HOUR // 2, 10 * HOUR, 10 * HOUR, GrantTooWide, "has reached its cap"),
        (HOUR // 2, 0, 0, GrantTooWide, "expires later than any ticket"),
        (DAY, 2 * DAY, 0, GrantTooWide, "expires later than any ticket"),
    ],
)
def test_grants_that_cannot_be_renewed(
    world: World, lifetime: int, cap: int, later: int, refusal: type[HintedError], message: str
) -> None:
    with pytest.raises(refusal, match=message):
        world.renew(world.grant(lifetime, cap), later)


def test_revoked_grants_are_not_renewed(world: World) -> None:
    data = world.grant()
    for entry in (grant_id(data), world.delegate.id or b"", world.master.thumbprint):
        world.revoked = entry
        with pytest.raises(GrantRevoked):
            world.renew(data)


def test_grants_of_another_key_authority_or_domain_are_refused(world: World) -> None:
    with pytest.raises(GrantNotHeld):
        world.renew(world.grant(), holder=world.master.thumbprint)
    with pytest.raises(HintedError, match="not a grant of this authority"):
        world.renew(Site().grant(world.node, P))
    with pytest.raises(GrantForged):
        world.renew(b"garbage")


def test_without_a_delegation_nothing_is_renewed() -> None:
    world = World()
    assert world.delegate.id is None
    with pytest.raises(RenewalNotInTime, match="has not delegated renewal") as refused:
        world.renew(world.grant())
    assert refused.value.hint == "at the authority: rossec master delegate"
    silent = TicketSigner(world.site.anchor, world.master.credentials.signer)
    assert silent.take(world.site.delegation(world.master))


def test_delegations_for_others_are_refused(world: World) -> None:
    with pytest.raises(GrantForOther):
        world.delegate.take(world.site.delegation(world.node))
    with pytest.raises(GrantForOther):
        world.delegate.take(world.site.delegation(world.master, domain="office"))
    with pytest.raises(GrantForged):
        world.delegate.take(Site().delegation(world.master))


def test_an_older_delegation_is_not_accepted(world: World) -> None:
    [first] = world.persisted
    newer = world.site.delegation(world.master, start=-50)
    assert world.delegate.take(newer)
    assert not world.delegate.take(first)
    assert not world.delegate.take(newer)
    assert world.persisted == [first, newer]
    assert world.delegate.id == open_delegation(newer, world.site.anchor.public_key).id
