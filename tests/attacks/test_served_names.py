"""Names that gateways serve, at the master: who offers them, who is told what, who learns nothing.

What nodes check of each other, whatever a master says, is in `test_false_gateways`.
"""

from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from dataclasses import replace

import pytest

from grants.model import Right
from rossec.errors import AnswerRefused, RossecError
from rossec.master.state.imported_facts import Site
from rossec.master.state.registry import Kind
from tests.rossec.master.gatewayworld import (
    ALIAS,
    MAY_BE_SERVED,
    NOTHING,
    ORIGIN,
    SERVED,
    SERVES,
    ServedWorld,
    is_told,
    told,
)
from tests.rossec.master.world import EVERYTHING, SlaveNode, T

ROBOT = "/remote/hospital/robot"


@pytest.fixture
async def world() -> AsyncIterator[ServedWorld]:
    async with AsyncExitStack() as stack:
        world = ServedWorld(stack)
        await world.start()
        yield world


async def offers_nothing(world: ServedWorld, node: SlaveNode) -> None:
    """Neither as publisher nor as provider, whatever its grants say."""
    watcher, before = await world.subscriber("/watcher")
    for topic in (SERVED, "/gateway/hospital/other", "/gateway/attic", ALIAS):
        with pytest.raises(AnswerRefused):
            await node.ask("registerPublisher", topic, T, node.uri)
        with pytest.raises(AnswerRefused):
            await node.ask("registerService", topic, "rosrpc://127.0.0.1:9", node.uri)
    assert (before, told(watcher)) == ([], [])


@pytest.mark.attack("served-publisher")
@pytest.mark.parametrize("name", ["/thief", "/gatewayx", "/gateway_1", "/gateway/hospital/pose"])
async def test_a_node_with_every_right_is_no_gateway(world: ServedWorld, name: str) -> None:
    await offers_nothing(world, await world.node(name, {**EVERYTHING, **SERVES}))


@pytest.mark.attack("served-publisher")
async def test_the_gateway_of_another_domain_is_a_visitor(world: ServedWorld) -> None:
    theirs = world.hospital.site.enroll("/gateway")
    await offers_nothing(world, await world.visitor({**EVERYTHING, **SERVES}, theirs))


@pytest.mark.attack("served-publisher")
async def test_who_may_clean_up_after_a_gateway_registers_nothing_for_it(world: ServedWorld) -> None:
    gateway = await world.gateway()
    admin = await world.node("/admin", EVERYTHING)
    for method, rest in (("registerPublisher", (T, admin.uri)), ("registerSubscriber", (T, ""))):
        with pytest.raises(RossecError):
            await admin.client.ask(method, "/gateway", SERVED, *rest)
    assert world.server.state.registry.uris(Kind.PUBLISHER, SERVED) == [gateway.uri]


@pytest.mark.attack("served-publisher")
async def test_a_gateway_serves_what_its_grants_say(world: ServedWorld) -> None:
    gateway = await world.gateway()
    for topic in ("/gateway/clinic/pose", "/pose", ALIAS, "/gateway"):
        with pytest.raises(AnswerRefused):
            await gateway.ask("registerPublisher", topic, T, gateway.uri)


@pytest.mark.attack("served-publisher")
async def test_another_master_names_no_other_publisher(world: ServedWorld) -> None:
    """One of the own domain, which is trusted for addresses, says that a robot serves."""
    watcher, _ = await world.subscriber("/watcher")
    lie = [("node", "/robot", "http://10.0.0.6:1/"), ("publisher", SERVED, "/robot")]
    world.server.state.imports.apply(Site("kitchen"), lie, [])
    assert await watcher.ask("registerSubscriber", ALIAS, T, watcher.uri) == []
    assert told(watcher) == []


@pytest.mark.attack("served-publisher")
async def test_what_a_visitor_publishes_here_is_no_topic_of_its_home(world: ServedWorld) -> None:
    visitor = await world.visitor({"/pose": Right.PUBLISH})
    await visitor.ask("registerPublisher", "/pose", T, visitor.uri)
    both, first = await world.subscriber("/both", origins=True)
    served, none = await world.subscriber("/served")
    assert (first, none) == ([ORIGIN], [])
    tool = await world.node("/tool", {"/pose": Right.GRAPH, **MAY_BE_SERVED})
    published = dict((await tool.ask("getSystemState"))[0])
    assert published == {"/pose": ["/remote/hospital/rounds/robot3"]}
    gateway = await world.gateway()
    await is_told(both, gateway.uri)
    await is_told(served, gateway.uri)


@pytest.mark.attack("served-rights")
@pytest.mark.parametrize("pattern", ["/remote/hospital/pose", "/remote/**", "/pose", "/remote/*/*"])
async def test_own_grants_about_the_origin_are_worth_nothing(world: ServedWorld, pattern: str) -> None:
    """An authority does not sign the first two; here it has."""
    await world.gateway()
    node = await world.node("/viewer", {pattern: Right(255)})
    with pytest.raises(AnswerRefused, match="needs the right subscribe on hospital:/pose"):
        await node.ask("registerSubscriber", ALIAS, T, node.uri)
    with pytest.raises(AnswerRefused):
        await node.ask("registerSubscriber", SERVED, T, node.uri)


@pytest.mark.attack("served-rights")
async def test_the_origins_grants_are_worth_nothing_on_a_served_name(world: ServedWorld) -> None:
    gateway = await world.gateway()
    node = await world.node("/viewer", NOTHING)
    grant = world.hospital.site.grant(node.member, {"/gateway/**": Right(255)})
    await node.ask("rossec.presentGrants", [grant])
    for topic in (ALIAS, SERVED):
        with pytest.raises(AnswerRefused):
            await node.ask("registerSubscriber", topic, T, node.uri)
    await world.present_origins(node)
    assert await node.ask("registerSubscriber", ALIAS, T, node.uri) == [ORIGIN]
    with pytest.raises(AnswerRefused):
        await node.ask("registerSubscriber", SERVED, T, node.uri)
    assert (await node.ask("getSystemState"))[0] == [[ALIAS, [ROBOT]]]
    with pytest.raises(AnswerRefused, match="unknown node"):
        await node.ask("lookupNode", "/gateway")
    assert await gateway.ask("lookupNode", "/gateway") == gateway.uri


@pytest.mark.attack("served-rights")
async def test_who_is_served_learns_nothing_of_the_origin(world: ServedWorld) -> None:
    gateway = await world.gateway()
    node, uris = await world.subscriber("/viewer")
    assert uris == [gateway.uri]
    published, subscribed, _ = await node.ask("getSystemState")
    assert sorted(published) == [[SERVED, ["/gateway"]], [ALIAS, ["/gateway"]]]
    assert subscribed == [[ALIAS, ["/viewer"]]]
    with pytest.raises(AnswerRefused, match="unknown node"):
        await node.ask("lookupNode", ROBOT)
    watcher = await world.node("/watcher", {**MAY_BE_SERVED, "/master": Right.GRAPH})
    shown = await watcher.ask("rossec.watchGraph", "", 0)
    assert ORIGIN not in str(shown)
    assert ROBOT not in str(shown)
    await gateway.ask("unregisterPublisher", SERVED, gateway.uri)
    await is_told(node)
    assert ALIAS not in dict((await node.ask("getSystemState"))[0])


@pytest.mark.attack("served-rights")
async def test_a_stranger_does_not_learn_what_is_served(world: ServedWorld) -> None:
    """The refusal is the same text, and nothing is listed."""
    stranger = await world.node("/stranger", NOTHING)

    async def refusal(topic: str) -> str:
        with pytest.raises(AnswerRefused) as caught:
            await stranger.ask("registerSubscriber", topic, T, stranger.uri)
        return str(caught.value).replace(topic.rpartition("/")[2], "X")

    before = [await refusal(topic) for topic in (ALIAS, SERVED)]
    await world.gateway()
    assert [await refusal(topic) for topic in (ALIAS, SERVED)] == before
    absent = [await refusal(topic.replace("pose", "none")) for topic in (ALIAS, SERVED)]
    assert absent == before
    assert await stranger.ask("getSystemState") == [[], [], []]
    assert await stranger.ask("getTopicTypes") == []
    assert await stranger.ask("getPublishedTopics", "") == []
    with pytest.raises(AnswerRefused, match="unknown node"):
        await stranger.ask("lookupNode", "/gateway")


@pytest.mark.attack("served-rights")
async def test_a_foreigner_is_served_no_alias(world: ServedWorld) -> None:
    await world.gateway()
    visitor = await world.visitor({**EVERYTHING, **MAY_BE_SERVED})
    for alias in (ALIAS, "/remote/clinic/pose"):
        with pytest.raises(AnswerRefused):
            await visitor.ask("registerSubscriber", alias, T, visitor.uri)
    assert ALIAS not in dict((await visitor.ask("getSystemState"))[0])


@pytest.mark.attack("served-rights")
async def test_what_is_served_ends_with_the_trust_in_the_domain(world: ServedWorld) -> None:
    gateway = await world.gateway()
    node, _ = await world.subscriber("/viewer")
    await gateway.ask("rossec.updateDomains", world.lists.next())
    registry = world.server.state.registry
    assert not registry.is_registered(Kind.SUBSCRIBER, ALIAS, "/viewer")
    with pytest.raises(AnswerRefused, match="no domain is called hospital here"):
        await node.ask("registerSubscriber", ALIAS, T, node.uri)
    assert ALIAS not in dict((await node.ask("getSystemState"))[0])


@pytest.mark.attack("served-rights")
async def test_what_is_not_taken_from_a_domain_is_not_served(world: ServedWorld) -> None:
    gateway = await world.gateway()
    node, uris = await world.subscriber("/viewer")
    assert uris == [gateway.uri]
    entry = replace(world.hospital.entry(), imported=(("/map", int(Right.SUBSCRIBE)),))
    await gateway.ask("rossec.updateDomains", world.lists.next(entry))
    await is_told(node)
