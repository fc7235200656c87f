"""Calls that take many turns, over real connections; here every reading of the clock ends one."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from itertools import count
from typing import Any
from xmlrpc.client import Fault

import pytest

from grants.document import grant_id
from rossec.errors import AnswerRefused
from rossec.master.api.methods import TurnClock
from rossec.master.rights.caller import NAMES_PER_YIELD
from rossec.master.server.answers import CallAnswers, PendingCall
from rossec.master.state.forwarded_ports import Target
from tests.rossec.master.world import SlaveNode, T, World, ends, until
from tests.support.caller import caller
from tests.support.site import Site

TOPICS = 20 * NAMES_PER_YIELD


@pytest.fixture
async def slow() -> AsyncIterator[World]:
    """A master whose turns are one step long."""
    async with AsyncExitStack() as exit_stack:
        world, ticks = World(exit_stack), count()
        await world.start(TurnClock(lambda: next(ticks)))
        yield world


async def crowd(world: World) -> None:
    """Enough topics that a query takes more than one turn."""
    for number in range(TOPICS // 1000 + 1):
        node = await world.node(f"/n{number}")
        calls = [
            {"methodName": "registerPublisher", "params": [f"/n{number}", topic, T, node.uri]}
            for topic in (f"/t{number}/x{i}" for i in range(min(1000, TOPICS - 1000 * number)))
        ]
        await node.client.call("system.multicall", calls)


async def while_pending(world: World, caller: SlaveNode, method: str, *params: object) -> Any:
    """The answer, and the number of other calls that were answered before it."""
    other = await world.node("/other")
    pending, answered = asyncio.ensure_future(caller.ask(method, *params)), 0
    while not pending.done():
        await other.ask("getPid")
        answered += 1
    return answered, await pending


async def test_other_calls_are_answered_during_a_query(slow: World) -> None:
    await crowd(slow)
    caller = await slow.node("/asker")
    answered, topics = await while_pending(slow, caller, "getPublishedTopics", "")
    assert len(topics) == TOPICS
    assert answered >= 5
    whole = await caller.ask("rossec.watchGraph", "", 0)
    assert whole["more"]


async def test_a_watcher_waits_for_changes_in_turns(slow: World, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rossec.master.server.answers.WATCH_WAIT", 0.05)
    caller = await slow.node("/asker")
    for number in range(2 * NAMES_PER_YIELD):
        await caller.ask("registerPublisher", f"/t{number}", T, caller.uri)
    whole = await caller.ask("rossec.watchGraph", "", 0)
    unchanged = await caller.ask("rossec.watchGraph", whole["instance"], whole["cursor"])
    assert (unchanged["added"], unchanged["removed"], unchanged["whole"]) == ([], [], False)


PUBLISHED = {"methodName": "getPublishedTopics", "params": ["/asker", ""]}
LONG = [("getPublishedTopics", "/asker", ""), ("system.multicall", [PUBLISHED])]


@pytest.mark.parametrize("question", LONG, ids=["alone", "in a multicall"])
async def test_a_query_begins_again_when_rights_are_revoked(slow: World, question: Any) -> None:
    """The answer was authorized by the list in force."""
    await crowd(slow)
    caller, other = await slow.node("/asker"), await slow.node("/other")
    pending = asyncio.ensure_future(caller.client.call(*question))
    await other.ask("getPid")
    await other.ask("rossec.updateRevocations", slow.site.revoke(grant_id(caller.grant)))
    assert not pending.done()
    answer: Any = await pending
    assert (answer[0][0] if len(question) == 2 else answer) == [1, "current topics", []]


@pytest.mark.parametrize("question", LONG, ids=["alone", "in a multicall"])
async def test_a_caller_revoked_during_a_query_is_not_answered(slow: World, question: Any) -> None:
    await crowd(slow)
    caller, other = await slow.node("/asker"), await slow.node("/other")
    pending = asyncio.ensure_future(caller.client.call(*question))
    await other.ask("getPid")
    await other.ask("rossec.updateRevocations", slow.site.revoke(caller.member.thumbprint))
    await ends(pending)
    await ends(caller.ask("getPid"))
    await other.ask("getPid")


async def test_a_call_that_waits_for_grants_is_answered_in_the_end(site: Site) -> None:
    assert site.master is not None
    site.master.state.grants_wait = 0.05
    empty = [1, "grants", {"grants": [], "more": False}]
    async with caller(site, "/robot") as robot:
        assert await robot("rossec.watchGrants", b"") == empty
        assert await robot("rossec.fetchGrants", b"") == empty
        assert "expected at most" in await robot.refused("rossec.watchGrants", b"x")


async def test_what_changes_before_a_watcher_has_begun_to_wait_is_told(slow: World) -> None:
    """The answer that has nothing new is of the call; a coroutine of the wait begins later."""
    watcher, robot = await slow.node("/watcher"), await slow.node("/robot")
    first = await watcher.ask("rossec.watchGraph", "", 0)
    waiting = asyncio.ensure_future(watcher.ask("rossec.watchGraph", first["instance"], first["cursor"]))
    await robot.ask("registerPublisher", "/t", T, robot.uri)
    async with asyncio.timeout(4):  # a wait without a change takes five
        changes = await waiting
    assert ["publisher", "/t", "/robot"] in changes["added"]


async def test_a_watcher_that_is_gone_or_refused_meanwhile_is_forgotten(
    slow: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    watcher, changes = await slow.node("/watcher"), slow.server.state.graph_changes
    first = await watcher.ask("rossec.watchGraph", "", 0)

    async def fails(self: CallAnswers, call: PendingCall) -> object:
        raise Fault(1, "revoked meanwhile")

    waiting = asyncio.ensure_future(watcher.ask("rossec.watchGraph", first["instance"], first["cursor"]))
    await until(lambda: len(changes) == 1)
    monkeypatch.setattr(CallAnswers, "_answer", fails)
    changes.notify()
    with pytest.raises(Fault, match="revoked meanwhile"):
        await waiting
    assert len(changes) == 0


async def test_a_relay_waits_until_something_is_wanted(slow: World) -> None:
    relay, forwarded_ports = await slow.node("/relay"), slow.server.state.forwarded_ports
    way = {"state": "up", "rtt_ms": 1.0, "retransmissions": 0, "router": "", "streams": 0}
    polls = slow.server.state.relay_polls
    target, forwarded_port = Target("office", "node", "/robot"), ["office", "node", "/robot", "127.0.0.1", 7]

    def poll(seen: int, *opened: object) -> "asyncio.Task[Any]":
        asked = relay.ask("rossec.relayForwardedPorts", "one", seen, [*opened], {"office": way})
        return asyncio.ensure_future(asked)

    assert (await poll(0))["wanted"] == [], "the first call of a relay is answered at once"
    first = poll(0)
    await until(lambda: len(polls) == 1)
    assert not first.done()
    forwarded_ports.want("office", [target])
    answer = await first
    assert answer["wanted"] == [["office", "node", "/robot"]]
    second = poll(answer["version"], forwarded_port)
    await until(lambda: forwarded_ports.forwarded_port(target) is not None)
    forwarded_ports.want("office", [])
    assert (await second)["unwanted"] == [["office", "node", "/robot"]]
    assert forwarded_ports.forwarded_port(target) is None


async def test_a_relay_that_is_refused_does_not_wait(slow: World) -> None:
    relay = await slow.node("/relay")
    with pytest.raises(AnswerRefused, match="bad call arity"):
        await relay.ask("rossec.relayForwardedPorts", "one", 0, [])
