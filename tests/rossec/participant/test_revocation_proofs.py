"""Where revocations are a tree: which proofs a node requests, and a site that works with them."""

import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from ca.errors import RevocationsStale, Revoked
from ca.revocation.lists import RevocationTree, Timestamp, TreeEntries, digest, sign_tree
from ca.revocation.trust_status import Revocations
from grants.model import Right
from rossec.errors import AnswerMalformed
from rossec.participant.authorized import STALE_GRACE
from rossec.participant.renewals import MAX_PROOFS_PER_CALL, REVOCATION_PROOFS, MasterCall, prove
from tests.rossec.participant.test_connections import make_connection
from tests.support.authority import Site as Authority
from tests.support.domains import alone
from tests.support.poses import POSE, first, pose, tell_master
from tests.support.site import Site
from tests.support.witness import until

LISTING = TreeEntries([n.to_bytes(16) for n in range(1, 9)])
HERE, ABSENT = (1).to_bytes(16), b"x" * 16


@pytest.fixture
def authority() -> Authority:
    return Authority(now=int(time.time()))


@pytest.fixture
def held(authority: Authority) -> Revocations:
    site = authority
    tree = RevocationTree(1, 1, site.now, site.now + 5000, *LISTING.size_and_root)
    data = sign_tree(site.signer, tree)
    revocations = site.revocations()
    revocations.update(data, site.now)
    revocations.confirm(Timestamp(1, digest(data), site.now, 30), site.now)
    for entry in (HERE, ABSENT):
        with pytest.raises(RevocationsStale):
            revocations.check(entry, site.now)
    return revocations


async def answer(method: str, *params: Any) -> list[bytes]:
    [wanted] = params
    assert method == REVOCATION_PROOFS
    return [LISTING.prove(entry) for entry in wanted]


def answering(value: object) -> MasterCall:
    async def call(method: str, *params: object) -> object:
        return value

    return call


async def test_a_wanted_proof_is_requested_once(held: Revocations) -> None:
    assert await prove(answer, held) == 2
    assert await prove(answer, held) == 0
    now = int(time.time())
    held.check(ABSENT, now)
    with pytest.raises(Revoked):
        held.check(HERE, now)


async def test_a_call_requests_a_limited_number_of_proofs(held: Revocations) -> None:
    for n in range(100, 100 + MAX_PROOFS_PER_CALL):
        with pytest.raises(RevocationsStale):
            held.check(n.to_bytes(16), int(time.time()))
    assert await prove(answer, held) == MAX_PROOFS_PER_CALL
    assert await prove(answer, held) == 2


@pytest.mark.parametrize("said", [5, [b"one"], [b"", b"", b""]])
async def test_a_malformed_answer_is_refused(held: Revocations, said: object) -> None:
    with pytest.raises(AnswerMalformed):
        await prove(answering(said), held)


@pytest.mark.parametrize("said", [[], [b"", 5], [b"x", b"y"]])
async def test_an_entry_without_a_valid_proof_stays_unknown(held: Revocations, said: object) -> None:
    assert await prove(answering(said), held) == 0
    with pytest.raises(RevocationsStale):
        held.check(ABSENT, int(time.time()))


def test_a_connection_without_a_proof_has_the_same_grace_period_as_without_timestamps(
    held: Revocations, authority: Authority
) -> None:
    trust_status = alone(authority.anchor, held)
    now = int(time.time())
    last = held.status_valid_until(b"g" * 16) + STALE_GRACE
    connection = make_connection(ends=last + 99)
    assert connection.termination_reason(trust_status, now) is None
    assert held.current is not None
    held.confirm(Timestamp(1, digest(held.data), last, 30), last)  # but no new proof
    assert connection.termination_reason(trust_status, last - 1) is None
    assert "no proof" in (connection.termination_reason(trust_status, last) or "")


@pytest.fixture
async def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Site]:
    """A site whose authority signs trees, as it does from the 4097th revocation on."""
    monkeypatch.setattr("rossec.authority.signing.MAX_ENTRIES", 0)
    site = Site(tmp_path / "site")
    site.revoke(bytes(32))
    async with site.running():
        yield site


async def test_nodes_work_with_proofs(site: Site) -> None:
    site.publish("/robot", "/robot/pose")
    right = site.subscribe("/viewer", "/robot/pose")
    site.grant("/other", Right.SUBSCRIBE, "/robot/pose")
    nodes = site.node("/robot"), site.node("/viewer"), site.node("/other")
    async with nodes[0] as robot, nodes[1] as viewer, nodes[2] as other:
        publisher = await robot.publisher("/robot/pose", POSE, latch=True)
        publisher.publish(pose(publisher))
        # Each connects when the proofs it needs have come: both wait at the same time.
        subscribers = [await node.subscriber("/robot/pose", POSE) for node in (viewer, other)]
        for subscriber in subscribers:
            await first(subscriber, within=30)
        assert len(publisher.links) == 2
        await tell_master(site, robot, site.revoke(right))
        await until(lambda: len(publisher.links) == 1, within=20)
        [connection] = publisher.links
        assert connection.stream.peer.name == "/other"
    assert site.master is not None
    await site.restart_master()
    async with site.node("/robot") as robot:
        await robot.publisher("/robot/pose", POSE)
