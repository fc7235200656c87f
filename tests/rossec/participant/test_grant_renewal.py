"""When grants are renewed, and that only valid tokens are held."""

import time
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from ca.errors import RevocationRefused, RevocationsStale, Revoked
from ca.keys.signing import KeySigner
from ca.revocation.lists import RevocationList, Timestamp, digest, sign_list, sign_timestamp
from ca.revocation.trust_status import Revocations
from grants.errors import GrantError, GrantMissing
from grants.model import Right
from grants.renewal import MIN_TICKET, Delegation, sign_delegation
from rossec.errors import AnswerMalformed
from rossec.master.rights.renewals import TicketSigner
from rossec.participant.access import Access
from rossec.participant.renewals import GRANT_RETRY, MAX_GRANTS_PER_CALL, MasterCall, Renewals, due_at, renew
from tests.support.authority import DAY, EnrolledNode, Site
from tests.support.domains import alone

HOUR = 3600
P = {"/t": Right.PUBLISH}


class World:
    """A node with grants, and a master that renews them."""

    def __init__(self) -> None:
        self.site = Site()
        self.now = self.site.now
        self.master, self.node = self.site.enroll("/master"), self.site.enroll("/node")
        self.revocations = Revocations(self.site.anchor.public_key)
        self.access = Access(alone(self.site.anchor, self.revocations))
        self.renewals = Renewals(self.access)
        self.list = b""
        self.at(0, self.site.revoke())
        self.calls: list[tuple[str, Any]] = []
        self.delegate = TicketSigner(self.site.anchor, self.master.credentials.signer)
        self.delegate.take(self.site.delegation(self.master))
        self.later = 0

    def at(self, later: int, data: bytes = b"", master: EnrolledNode | None = None) -> int:
        """Let time pass, with a fresh timestamp."""
        master = master or self.master
        self.list = data or self.list
        self.later = later
        now = self.now + later
        seq = 1 if self.revocations.current is None else self.revocations.current.seq + bool(data)
        signer = master.credentials.signer
        assert isinstance(signer, KeySigner)
        stamp = sign_timestamp(signer, Timestamp(seq, digest(self.list), now, 30))
        self.access.update_revocations(data, stamp, master.identity, now, lambda _: None)
        return now

    def hold(self, lifetime: int = HOUR, cap: int = DAY, holder: EnrolledNode | None = None) -> bytes:
        data = self.site.grant(holder or self.node, P, lifetime=lifetime, cap=cap)
        self.access.hold(data)
        return data

    async def answer(self, method: str, *params: Any) -> list[bytes]:
        [originals] = params
        self.calls.append((method, originals))
        return [self.renewed(data) for data in originals]

    def renewed(self, data: bytes) -> bytes:
        held = self.revocations.current
        assert held is not None
        now = self.now + self.later
        _, token = self.delegate.renew(
            data, self.node.thumbprint, now, seq=held.seq, check=self.revocations.check
        )
        return token


def answering(value: object) -> MasterCall:
    async def call(method: str, *params: object) -> object:
        return value

    return call


@pytest.fixture
def world() -> World:
    return World()


def test_a_grant_is_due_at_about_two_thirds_of_its_lifetime(world: World) -> None:
    world.hold()
    [held] = world.access.held_grants()
    assert 0.55 * HOUR <= due_at(held) - world.now <= 0.77 * HOUR
    assert world.renewals.due(due_at(held) - 1) == []
    assert world.renewals.due(due_at(held)) == [held]
    assert world.renewals.due(due_at(held) + GRANT_RETRY - 1) == []
    assert world.renewals.due(due_at(held) + GRANT_RETRY) == [held]


def test_a_refused_grant_is_requested_again_before_it_expires(world: World) -> None:
    """A ticket of a minute has some 20 s left: after a pause of a minute it would have expired."""
    world.hold(lifetime=60)
    [held] = world.access.held_grants()
    asked = [second for second in range(60) if world.renewals.due(world.now + second)]
    assert asked[0] == due_at(held) - world.now
    assert len(asked) >= 4
    assert max(late - early for early, late in pairwise(asked)) <= 7
    assert world.renewals.due(world.now + 60) == [held]  # expired: the longest pause
    assert world.renewals.due(world.now + 60 + GRANT_RETRY - 1) == []
    assert world.renewals.due(world.now + 60 + GRANT_RETRY) == [held]


async def test_with_tickets_of_a_minute_a_node_always_holds_a_valid_one(world: World) -> None:
    """The pause after a refusal does not apply to a renewed grant."""
    delegation = Delegation(
        "home", world.master.thumbprint, world.now - 1, world.now + DAY, MIN_TICKET, bytes(16)
    )
    world.delegate = TicketSigner(world.site.anchor, world.master.credentials.signer)
    world.delegate.take(sign_delegation(world.site.signer, delegation))
    world.hold(lifetime=50)
    least = 60
    for second in range(600):
        now = world.at(second)
        await renew(world.answer, world.renewals, now)
        [held] = world.access.held_grants()
        least = min(least, held.grant.expires - now)
    assert least >= 12  # seconds: enough for more tries if the master is out of reach
    assert 13 <= len(world.calls) <= 22


def test_a_grant_is_not_due_beyond_its_cap_or_when_revoked(world: World) -> None:
    data = world.hold()
    assert world.renewals.due(world.now + DAY) == []
    world.at(0, world.site.revoke(data))
    assert world.renewals.due(world.now + 2 * HOUR) == []
    world.hold(cap=0)
    assert world.renewals.due(world.now + 2 * HOUR) == []


async def test_a_new_epoch_makes_all_renewed_grants_due(world: World) -> None:
    world.hold()
    assert await renew(world.answer, world.renewals, world.at(HOUR)) == 1
    assert world.renewals.due(world.now + HOUR + 1) == []
    listed = RevocationList(2, 1, world.now + HOUR, world.now + DAY, frozenset())
    data = sign_list(world.site.signer, listed)
    stamp = Timestamp(1, digest(data), world.now + HOUR, 30)
    world.revocations.update(data, world.now + HOUR)
    world.revocations.confirm(stamp, world.now + HOUR)
    assert await renew(world.answer, world.renewals, world.now + HOUR + 2) == 1
    assert world.renewals.due(world.now + HOUR + 3 * GRANT_RETRY) == []


def test_a_call_renews_a_limited_number_of_grants_the_first_to_expire_first(world: World) -> None:
    for n in range(MAX_GRANTS_PER_CALL + 1):
        world.hold(lifetime=HOUR + n)
    due = world.renewals.due(world.now + 2 * HOUR)
    assert [held.grant.expires - world.now for held in due] == [HOUR + n for n in range(MAX_GRANTS_PER_CALL)]
    assert len(world.renewals.due(world.now + 2 * HOUR)) == 1


async def test_an_expired_grant_is_renewed(world: World) -> None:
    data = world.hold()
    now = world.at(2 * HOUR)
    assert world.access.current(now) == []
    assert await renew(world.answer, world.renewals, now) == 1
    assert world.calls == [("rossec.renewGrants", [data])]
    [token] = world.access.current(now)
    assert token != data
    [held] = world.access.held_grants()
    assert (held.original, held.since) == (data, now)
    assert await renew(world.answer, world.renewals, now + GRANT_RETRY) == 0
    decision = world.access.authorize(
        world.node.identity, world.access.present(Right.PUBLISH, "/t", now), Right.PUBLISH, "/t", now
    )
    assert decision.expires == held.grant.expires


async def test_nothing_is_requested_before_it_is_due(world: World) -> None:
    world.hold()
    assert await renew(world.answer, world.renewals, world.now) == 0
    assert world.calls == []


@pytest.mark.parametrize("answer", [5, [], [b"", b""]])
async def test_a_malformed_answer_is_refused(world: World, answer: object) -> None:
    world.hold()
    with pytest.raises(AnswerMalformed):
        await renew(answering(answer), world.renewals, world.at(HOUR))


@pytest.mark.parametrize("token", [b"", 5, b"garbage"])
async def test_an_invalid_token_is_not_held(
    world: World, token: object, caplog: pytest.LogCaptureFixture
) -> None:
    world.hold()
    now = world.at(HOUR)
    assert await renew(answering([token]), world.renewals, now) == 0
    assert world.access.current(now) == []
    assert ("is invalid" in caplog.text) == (token == b"garbage")


def test_a_renewed_grant_of_another_node_is_refused(world: World) -> None:
    unknown = world.site.grant(world.node, P, lifetime=60, cap=DAY)
    with pytest.raises(GrantMissing, match="is not held by this node"):
        world.access.hold_renewed(world.renewed(unknown), world.now)


def test_tokens_of_a_revoked_delegation_are_refused(world: World) -> None:
    data = world.hold(lifetime=60)
    token = world.renewed(data)
    assert world.delegate.id is not None
    world.at(0, world.site.revoke(world.delegate.id))
    with pytest.raises(GrantError, match="delegation"):
        world.access.hold_renewed(token, world.now)
    with pytest.raises(RevocationRefused):
        world.access.update_revocations(b"", b"no stamp", world.master.identity, world.now, lambda _: None)


def test_a_timestamp_of_a_revoked_master_is_refused(world: World) -> None:
    """A stolen key could otherwise confirm a list that a newer one replaces."""
    fresh = world.revocations.fresh_until
    with pytest.raises(Revoked):
        world.at(20, world.site.revoke(world.master.identity.thumbprint))
    with pytest.raises(Revoked):
        world.at(25)
    assert world.revocations.fresh_until <= fresh
    assert world.revocations.current is not None
    with pytest.raises(RevocationsStale):
        world.revocations.check_fresh(world.now + 25)


def test_a_peer_that_does_not_know_the_master_refuses_a_renewed_grant(tmp_path: Path) -> None:
    world = World()
    token = world.renewed(world.site.grant(world.node, P, lifetime=60, cap=DAY))
    other = Access(alone(world.site.anchor, world.revocations))
    with pytest.raises(GrantError, match="the master's key is not known"):
        other.hold_renewed(token, int(time.time()))
