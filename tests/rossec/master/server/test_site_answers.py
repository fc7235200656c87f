"""A query for what was not wanted before waits for the sites, and not for long."""

import asyncio
import time
from typing import Any

import pytest

from rossec.errors import AnswerRefused
from rossec.host.runner import TaskSet
from rossec.master.server.answers import SITES_WAIT
from rossec.master.server.updates import LongPolls
from rossec.master.state.imported_facts import Site
from rossec.master.state.imports import Imports
from rossec.master.state.registry import Registry
from tests.rossec.master.world import SlaveNode, World, until

KITCHEN = Site("kitchen")
FACTS = [
    ("node", "/robot", "http://10.0.0.2:1/"),
    ("service", "/reset", "/robot"),
    ("provider", "/reset", "rosrpc://10.0.0.2:9"),
]


@pytest.fixture
def imports() -> Imports:
    imports = Imports(Registry())
    imports.apply(KITCHEN, [], [])
    return imports


@pytest.fixture
def waits(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """How long each query for which the sites are waited for may wait."""
    waited: list[float] = []
    wait = LongPolls.wait

    async def note(polls: LongPolls, longest: float, *given: Any) -> None:
        if longest == SITES_WAIT:
            waited.append(longest)
        await wait(polls, longest, *given)

    monkeypatch.setattr(LongPolls, "wait", note)
    return waited


async def finds_nothing(node: SlaveNode, service: str) -> None:
    with pytest.raises(AnswerRefused, match="no provider"):
        await node.ask("lookupService", service)


def settled_by(imports: Imports) -> LongPolls:
    settled = LongPolls(0.0)
    imports.on_settled = settled.notify
    return settled


async def test_a_wait_ends_when_the_sites_have_answered(imports: Imports) -> None:
    settled, tasks = settled_by(imports), TaskSet()
    waiting = [tasks.spawn(settled.wait(30), "query") for _ in range(2)]
    await asyncio.sleep(0.01)
    imports.settle("kitchen", imports.demand.version)
    async with asyncio.timeout(10):
        await asyncio.gather(*waiting)
    await tasks.close()


async def test_a_site_that_is_lost_is_not_waited_for(imports: Imports) -> None:
    settled, tasks = settled_by(imports), TaskSet()
    waiting = tasks.spawn(settled.wait(30), "query")
    await asyncio.sleep(0.01)
    imports.lose("kitchen")
    async with asyncio.timeout(10):
        await waiting
    await tasks.close()


async def test_the_first_lookup_of_a_name_waits_for_the_sites(world: World, waits: list[float]) -> None:
    node, imports, tasks = await world.node("/a"), world.server.state.imports, TaskSet()
    imports.apply(KITCHEN, [], [])
    imports.settle("kitchen", imports.demand.version)
    lookup = tasks.spawn(node.ask("lookupService", "/reset"), "lookup")
    await until(lambda: not imports.is_settled)
    imports.apply(KITCHEN, FACTS, [])
    imports.settle("kitchen", imports.demand.version)
    async with asyncio.timeout(10):
        assert await lookup == "rosrpc://10.0.0.2:9"
    waits.clear()
    begin = time.monotonic()
    await finds_nothing(node, "/none")  # the site does not answer
    assert time.monotonic() - begin >= 0.9
    await finds_nothing(node, "/none")  # which is known now
    assert len(waits) == 1
    await tasks.close()


async def test_a_master_that_follows_nobody_answers_at_once(world: World, waits: list[float]) -> None:
    node = await world.node("/a")
    for number in range(3):
        await finds_nothing(node, f"/none{number}")
    assert waits == []


async def test_a_follower_is_answered_shortly_when_nothing_changes(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rossec.master.server.answers.WATCH_WAIT", 0.05)
    node = await world.node("/a")
    first: Any = await node.ask("rossec.followSite", "", 0, [])
    assert first["whole"]
    assert len(first["revocations"]) == 32
    following = first["instance"], first["cursor"]
    assert await node.ask("rossec.followSite", *following, []) == {}
    await node.ask("registerPublisher", "/t", "std_msgs/String", node.uri)
    changed: Any = await node.ask("rossec.followSite", *following, [])
    assert ["publisher", "/t", "/a"] in changed["added"]
    following = changed["instance"], changed["cursor"]
    fewer: Any = await node.ask("rossec.followSite", *following, [""])
    assert fewer["removed"] == changed["added"]


async def test_a_new_list_ends_the_wait_of_a_follower(world: World) -> None:
    node, other, tasks = await world.node("/a"), await world.node("/b"), TaskSet()
    first: Any = await node.ask("rossec.followSite", "", 0, [])
    following = first["instance"], first["cursor"]
    begin = time.monotonic()
    waiting = tasks.spawn(node.ask("rossec.followSite", *following, []), "follower")
    await until(lambda: len(world.server.state.site_polls) == 1)
    await other.ask("rossec.updateRevocations", world.site.revoke(b"x" * 32))
    async with asyncio.timeout(10):
        changed: Any = await waiting
    assert time.monotonic() - begin < 4
    assert changed["revocations"] not in (b"", first["revocations"])
    await tasks.close()
