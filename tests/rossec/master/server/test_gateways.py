"""Gateways that die are unregistered, silent ones left, and each subscriber is told its list."""

import asyncio
import socket
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from typing import Any

import pytest

from grants.model import Right
from rossec.errors import AnswerRefused
from rossec.master.server import maintenance
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
from tests.rossec.master.world import SlaveNode, T, until


@pytest.fixture
async def world(monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[ServedWorld]:
    monkeypatch.setattr(maintenance, "ASK_EVERY", 0.05)
    monkeypatch.setattr(maintenance, "RETRY_AFTER", 0.05)
    monkeypatch.setattr(maintenance, "SILENT_AFTER", 0.2)
    async with AsyncExitStack() as stack:
        world = ServedWorld(stack)
        await world.start()
        yield world


def is_registered(world: ServedWorld) -> bool:
    return world.server.state.registry.node("/gateway") is not None


async def test_each_subscriber_hears_of_a_gateway_that_comes(world: ServedWorld) -> None:
    served, before = await world.subscriber("/served", origins=False)
    both, direct = await world.subscriber("/both", origins=True)
    assert (before, direct) == ([], [ORIGIN])
    gateway = await world.gateway()
    await is_told(served, gateway.uri)
    await is_told(both, gateway.uri)
    origins = await world.node("/origins", NOTHING)
    await world.present_origins(origins)
    assert await origins.ask("registerSubscriber", ALIAS, T, origins.uri) == [ORIGIN]
    await gateway.ask("unregisterPublisher", SERVED, gateway.uri)
    await is_told(served)
    await is_told(both, ORIGIN)
    assert told(origins) == []


async def test_a_gateway_that_has_died_is_unregistered(
    world: ServedWorld, caplog: pytest.LogCaptureFixture
) -> None:
    gateway = await world.gateway()
    both, now = await world.subscriber("/both", origins=True)
    served, _ = await world.subscriber("/served", origins=False)
    assert now == [gateway.uri]
    await until(lambda: len(gateway.received_calls("getPid")) > 1)
    await gateway.server.close()
    await is_told(both, ORIGIN)
    await is_told(served)
    assert not is_registered(world)
    assert f"/gateway is unregistered: nobody listens at {gateway.uri}" in caplog.text
    await until(lambda: len(world.server._gateways) == 0)


async def test_a_gateway_that_comes_back_serves_again(world: ServedWorld) -> None:
    first = await world.gateway()
    served, _ = await world.subscriber("/served", origins=False)
    await first.server.close()
    await is_told(served)
    again = SlaveNode(world, first.member)
    await again.start(SERVES)
    await again.ask("registerPublisher", SERVED, T, again.uri)
    await is_told(served, again.uri)
    await until(lambda: again.received_calls("getPid") != [])


async def test_a_gateway_that_hangs_is_left_until_it_answers(
    world: ServedWorld, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(maintenance, "ANSWER_WITHIN", 0.3)
    gateway = await world.gateway()
    goes_on, usual = asyncio.Event(), gateway.dispatch
    goes_on.set()

    async def answer(*call: Any) -> object:
        await goes_on.wait()
        return await usual(*call)

    monkeypatch.setattr(gateway, "dispatch", answer)
    await gateway.server.close()  # it listens again, with the other answers
    await gateway.start(SERVES)
    await gateway.ask("registerPublisher", SERVED, T, gateway.uri)
    both, _ = await world.subscriber("/both", origins=True)
    goes_on.clear()
    await is_told(both, ORIGIN)
    assert is_registered(world)
    assert "/gateway does not answer" in caplog.text
    tool = await world.node("/tool", MAY_BE_SERVED)
    assert [ALIAS, ["/gateway"]] not in (await tool.ask("getSystemState"))[0]
    goes_on.set()
    monkeypatch.setattr(maintenance, "ANSWER_WITHIN", 30.0)
    await is_told(both, gateway.uri)
    assert "/gateway answers again" in caplog.text
    assert [ALIAS, ["/gateway"]] in (await tool.ask("getSystemState"))[0]


async def test_a_refusal_is_an_answer(world: ServedWorld) -> None:
    gateway = await world.gateway()
    gateway.answer = [-1, "not for you", 0]
    before = len(gateway.received_calls("getPid"))
    await until(lambda: len(gateway.received_calls("getPid")) > before + 6)
    assert is_registered(world)


async def test_where_nothing_is_served_nobody_is_asked(world: ServedWorld) -> None:
    gateway = await world.node("/gateway", {"/**": Right(255)})
    await gateway.ask("registerPublisher", "/state", T, gateway.uri)
    await gateway.ask("registerSubscriber", SERVED, T, gateway.uri)
    assert len(world.server._gateways) == 0
    await gateway.ask("registerPublisher", SERVED, T, gateway.uri)
    assert len(world.server._gateways) == 1
    await gateway.ask("unregisterPublisher", SERVED, gateway.uri)
    await until(lambda: len(world.server._gateways) == 0)
    assert is_registered(world)


async def test_another_node_at_its_address_takes_its_place_in_nothing(world: ServedWorld) -> None:
    heir = await world.node("/heir")
    gateway = await world.node("/gateway", SERVES)
    await gateway.ask("registerPublisher", SERVED, T, heir.uri)
    await until(lambda: not is_registered(world))
    assert heir.received_calls("getPid") == []


async def test_an_address_that_does_not_answer_is_no_gateway(
    world: ServedWorld, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(maintenance, "ANSWER_WITHIN", 0.2)
    with socket.create_server(("127.0.0.1", 0)) as mute:  # takes connections, says nothing
        gateway = await world.node("/gateway", SERVES)
        served, _ = await world.subscriber("/served", origins=False)
        uri = f"http://127.0.0.1:{mute.getsockname()[1]}/"
        await gateway.ask("registerPublisher", SERVED, T, uri)
        await is_told(served, uri)
        await is_told(served)
        assert is_registered(world)


async def test_rights_that_come_and_go_move_a_subscriber(world: ServedWorld) -> None:
    gateway = await world.gateway()
    viewer = await world.node("/viewer", NOTHING)
    await world.present_origins(viewer)
    assert await viewer.ask("registerSubscriber", ALIAS, T, viewer.uri) == [ORIGIN]
    mine = world.site.grant(viewer.member, MAY_BE_SERVED)
    await viewer.ask("rossec.presentGrants", [mine])
    await is_told(viewer, gateway.uri)
    await viewer.ask("rossec.updateRevocations", world.site.revoke(mine))
    await is_told(viewer, ORIGIN)
    assert world.server.state.registry.is_registered(Kind.SUBSCRIBER, ALIAS, "/viewer")


async def test_nobody_but_a_gateway_serves(world: ServedWorld) -> None:
    served, _ = await world.subscriber("/served", origins=False)
    thief = await world.node("/thief", {"/**": Right(255)})
    with pytest.raises(AnswerRefused, match="only gateways of this domain publish"):
        await thief.ask("registerPublisher", SERVED, T, thief.uri)
    assert told(served) == []
    assert len(world.server._gateways) == 0
