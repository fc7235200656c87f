"""A receiver that may know somebody's presence to a slot asks the master when a publisher came."""

import asyncio
import secrets
import time
from contextlib import AsyncExitStack

import pytest

from grants.document import sign
from grants.model import Draft, Permission, Restriction, Right
from tests.rossec.master.rights.slotted import FORWARDED_PORT, SLOT, URI, SlottedMaster
from tests.rossec.master.world import World, until

SECONDS = 10


@pytest.mark.attack("registration-moments")
def test_no_answer_changes_but_where_a_slot_begins() -> None:
    """Every call about the graph, in every second; the sensor comes at 65 and goes at 130."""
    master = SlottedMaster()
    by_slot: dict[int, set[tuple[tuple[str, object], ...]]] = {}
    told = {}
    for now in range(241):
        if now == 65:
            master.publish(now)
        if now == 130:
            master.end(now)
        master.maintain(now)
        answers = master.answers(master.watcher, now)
        told[now] = master.subscribe(master.watcher, now) if now else []
        if now > 1:
            by_slot.setdefault(now // SLOT, set()).add(tuple(answers.items()))
    assert all(len(found) == 1 for found in by_slot.values())
    assert by_slot[0] == by_slot[1] == by_slot[3] != by_slot[2]
    assert {now for now, uris in told.items() if uris} == set(range(120, 180))


@pytest.mark.attack("registration-moments")
def test_updates_are_sent_where_a_slot_begins() -> None:
    """And at once to whom no slot is for, and of what a revocation ends."""
    master = SlottedMaster()
    for who in (master.watcher, master.witness):
        assert master.subscribe(who, 0) == []
    for now in range(1, 200):
        master.maintain(now)
        if now == 65:
            master.publish(now)
        if now == 130:
            master.end(now)
    assert master.sent["/witness"] == [(65, [URI]), (130, [])]
    assert master.sent["/watcher"] == [(120, [URI]), (180, [])]
    master.publish(200)
    master.maintain(240)
    del master.statements.callers["/sensor"]
    master.deliver(master.registry.remove_node("/sensor"), 250)
    assert master.sent["/watcher"][2:] == [(240, [URI]), (250, [])]
    assert FORWARDED_PORT not in str(master.answers(master.watcher, 251)["getPublishedTopics"])


@pytest.mark.attack("registration-moments")
async def test_a_master_tells_in_the_next_slot() -> None:
    async with AsyncExitStack() as stack:
        world = World(stack)
        await world.start()
        begin = time.time()
        shift = SECONDS - begin % SECONDS - 1.5  # a slot begins soon
        world.server.state.clock = lambda: time.time() + shift
        sensor = await world.node("/sensor", {FORWARDED_PORT: Right.PUBLISH})
        witness = await world.node("/witness", {FORWARDED_PORT: Right.SUBSCRIBE})
        watcher = await world.node("/watcher", {"/other": Right.SUBSCRIBE})
        draft = Draft(
            domain=world.site.domain,
            subject="/watcher",
            holder=watcher.member.thumbprint,
            not_before=world.site.now,
            expires=world.site.now + 900,
            cap=world.site.now + 900,
            serial=secrets.token_bytes(16),
            permissions=(Permission(FORWARDED_PORT, Right.SUBSCRIBE, Restriction(slot=SECONDS)),),
        )
        await watcher.ask("rossec.presentGrants", [sign(world.site.signer, draft)])
        for node in (witness, watcher):
            assert await node.ask("registerSubscriber", FORWARDED_PORT, "*", node.uri) == []
        came = world.server.state.now() // SECONDS
        await sensor.ask("registerPublisher", FORWARDED_PORT, "std_msgs/Bool", sensor.uri)
        await until(lambda: witness.received_calls("publisherUpdate") == [(FORWARDED_PORT, [sensor.uri])])
        if world.server.state.now() // SECONDS == came:
            assert watcher.received_calls("publisherUpdate") == []
        await until(lambda: watcher.received_calls("publisherUpdate") == [(FORWARDED_PORT, [sensor.uri])])
        assert world.server.state.now() // SECONDS > came


@pytest.mark.attack("registration-moments")
async def test_a_wait_for_the_graph_does_not_end_with_what_is_not_seen() -> None:
    """Its end would be the moment: it goes on until something that the watcher sees changes."""
    async with AsyncExitStack() as stack:
        world = World(stack)
        await world.start()
        watcher = await world.node("/watcher", {"/master": Right.GRAPH, "/seen": Right.GRAPH})
        sensor = await world.node("/sensor", {"/**": Right.PUBLISH})
        whole = await watcher.ask("rossec.watchGraph", "", 0)
        async with asyncio.TaskGroup() as tasks:
            waiting = tasks.create_task(watcher.ask("rossec.watchGraph", whole["instance"], whole["cursor"]))
            await asyncio.sleep(0.1)
            await sensor.ask("registerPublisher", "/hidden", "std_msgs/Bool", sensor.uri)
            await asyncio.sleep(0.3)
            assert not waiting.done()
            await sensor.ask("registerPublisher", "/seen", "std_msgs/Bool", sensor.uri)
        assert ["publisher", "/seen", "/sensor"] in waiting.result()["added"]
