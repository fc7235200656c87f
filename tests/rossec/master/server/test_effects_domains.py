"""Lists of domains and of foreign revocations: enforced, audited, and sent to the own nodes."""

from collections.abc import AsyncIterator
from contextlib import AsyncExitStack

import pytest

from ca.errors import RevocationRefused, RevocationsStale
from grants.model import Right
from tests.rossec.master.visiting import HOSPITAL, VisitWorld
from tests.rossec.master.world import EVERYTHING, SlaveNode, T, ends, until

POSE = "/remote/hospital/pose"
DOMAINS = "rossec.domainsUpdate"
FOREIGN = "rossec.foreignRevocationUpdate"


@pytest.fixture
async def world() -> AsyncIterator[VisitWorld]:
    async with AsyncExitStack() as stack:
        world = VisitWorld(stack)
        await world.start()
        yield world


async def registered(world: VisitWorld, name: str) -> SlaveNode:
    node = await world.node(name)
    await node.ask("registerSubscriber", "/t", T, node.uri)
    return node


async def test_a_newer_list_of_domains_is_sent_to_every_own_node(
    world: VisitWorld, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO", "rossec.audit")
    robot, viewer = await registered(world, "/robot"), await registered(world, "/viewer")
    visitor = await world.visitor(EVERYTHING)
    await visitor.ask("registerSubscriber", "/t", T, visitor.uri)
    newest = world.lists.next(world.hospital.entry(fresh=7200))
    await robot.ask("rossec.updateDomains", newest)
    await until(lambda: all(node.received_calls(DOMAINS) for node in (robot, viewer)))
    assert viewer.received_calls(DOMAINS) == [(newest,)]
    assert visitor.received_calls(DOMAINS) == []
    assert "/robot delivered list of domains 2" in caplog.text


async def test_a_removal_closes_and_says_whom(world: VisitWorld, caplog: pytest.LogCaptureFixture) -> None:
    viewer, visitor = await registered(world, "/viewer"), await world.visitor(EVERYTHING)
    await visitor.ask("registerPublisher", "/t", T, visitor.uri)
    await until(lambda: viewer.received_calls("publisherUpdate") == [("/t", [visitor.uri])])
    await viewer.ask("rossec.updateDomains", world.lists.next())
    await until(lambda: viewer.received_calls("publisherUpdate")[-1] == ("/t", []))
    assert "hospital:/rounds/robot3 is disconnected: " in caplog.text
    await ends(visitor.ask("getPid"))


async def test_foreign_revocations_are_sent_to_every_own_node(world: VisitWorld) -> None:
    viewer, visitor = await registered(world, "/viewer"), await world.visitor(EVERYTHING)
    await visitor.ask("registerPublisher", "/x", T, visitor.uri)
    word = world.hospital.word(b"g" * 16)
    world.server.effects.take_foreign(HOSPITAL, *word)
    await until(lambda: viewer.received_calls(FOREIGN) != [])
    assert viewer.received_calls(FOREIGN) == [(HOSPITAL, word[0], word[1], list(word[2]))]
    assert visitor.received_calls(FOREIGN) == []


async def test_a_word_without_a_newer_list_is_not_sent(world: VisitWorld) -> None:
    viewer, word = await registered(world, "/viewer"), world.hospital.word()
    world.server.effects.take_foreign(HOSPITAL, *word)
    await until(lambda: len(viewer.received_calls(FOREIGN)) == 1)
    world.server.effects.take_foreign(HOSPITAL, *word)
    await registered(world, "/other")
    assert len(viewer.received_calls(FOREIGN)) == 1


async def test_a_list_without_a_timestamp_is_enforced_and_sent(world: VisitWorld) -> None:
    viewer, visitor = await registered(world, "/viewer"), await world.visitor(EVERYTHING)
    data = world.hospital.word(world.robot)[0]
    with pytest.raises(RevocationsStale):
        world.server.effects.take_foreign(HOSPITAL, data, b"", ())
    await until(lambda: viewer.received_calls(FOREIGN) == [(HOSPITAL, data, b"", [])])
    await ends(visitor.ask("getPid"))


async def test_an_older_foreign_list_changes_nothing(world: VisitWorld) -> None:
    old = world.hospital.word()
    world.take()
    viewer = await registered(world, "/viewer")
    with pytest.raises(RevocationRefused, match="is older than"):
        world.server.effects.take_foreign(HOSPITAL, *old)
    assert viewer.received_calls(FOREIGN) == []


async def test_a_registration_ends_with_the_grant_its_authority_revoked(world: VisitWorld) -> None:
    own = await world.node("/robot", {"/own": Right.SUBSCRIBE})
    grant = world.hospital.site.grant(own.member, {"/pose": Right.SUBSCRIBE})
    await own.ask("rossec.presentGrants", [grant])
    await own.ask("registerSubscriber", POSE, T, own.uri)
    world.take(grant)
    assert list(world.server.state.registry.nodes()) == []


async def test_denials_name_foreigners_by_their_domain(
    world: VisitWorld, caplog: pytest.LogCaptureFixture
) -> None:
    visitor = await world.visitor({"/t": Right.CALL})
    with pytest.raises(Exception, match="needs the right publish"):
        await visitor.ask("registerPublisher", "/t", T, visitor.uri)
    assert "hospital:/rounds/robot3 may not publish /t (registerPublisher)" in caplog.text
