"""The node of the preview on a real site: it receives what it was granted, and nothing else."""

import asyncio
import socket
from collections.abc import AsyncIterator
from itertools import pairwise
from typing import Any

import pytest

from rossec.console import preview as receiver
from rossec.console.preview import NAME, PreviewReceiver, receive
from rossec.console.samples import see
from rossec.console.server.web import PreviewClient
from rossec.host.runner import TaskSet
from rossec.node import Publisher
from tests.support.caller import caller
from tests.support.discovered import Searches
from tests.support.site import Site, coarse

POSE = "geometry_msgs/PoseStamped"


@pytest.fixture
async def site(site: Site) -> Site:
    site.enroll(NAME)
    return site


@pytest.fixture
async def client(site: Site) -> AsyncIterator[PreviewClient]:
    ours, theirs = socket.socketpair()
    client, tasks = PreviewClient(ours), TaskSet()
    client.start()
    _, writer = await asyncio.open_connection(sock=theirs)
    tasks.spawn(PreviewReceiver(writer, site.environ, period=0.1).run(), "preview")
    yield client
    await tasks.close()
    await client.close()
    writer.transport.abort()


async def drive(publisher: Publisher) -> None:
    for number in range(10**6):
        message = publisher.create()
        message.header.frame_id = "map"
        message.pose.position.x = float(number)
        publisher.publish(message)
        await asyncio.sleep(0.01)


async def until_recorded(client: PreviewClient, topic: str, count: int = 1) -> Any:
    async with asyncio.timeout(60):
        while True:
            found = client.recorded(topic)
            if found is not None and len(found.messages) >= count:
                return found
            await asyncio.sleep(0.02)


async def test_its_master_is_discovered(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    found = Searches()
    found.result = site.environ["ROS_MASTER_URI"]
    monkeypatch.setattr(receiver, "discover_master", found.discover)
    site.publish("/robot", "/pose")
    site.subscribe(NAME, "/pose")
    ours, theirs = socket.socketpair()
    environ = {**site.environ, "ROS_MASTER_URI": "discover:"}
    running = asyncio.ensure_future(receive(theirs, environ))
    async with site.node("/robot") as robot:
        publisher = await robot.publisher("/pose", POSE)
        await publisher.wait_for_subscribers()
    assert found.made == [NAME]
    ours.close()
    await running


async def test_it_receives_what_it_was_granted(site: Site, client: PreviewClient) -> None:
    for topic in ("/pose", "/secret"):
        site.publish("/robot", topic)
    site.subscribe(NAME, "/pose")
    tasks = TaskSet()
    async with site.node("/robot") as robot:
        for topic in ("/pose", "/secret"):
            tasks.spawn(drive(await robot.publisher(topic, POSE)), topic)
        found = await until_recorded(client, "/pose", 5)
        await tasks.close()
    assert found.type == POSE
    times = [at for at, _ in found.messages]
    assert min(later - at for at, later in pairwise(times)) > 0.05
    assert client.recorded("/secret") is None
    exact, rough = see(found, "/doctor", []), see(found, "/heating", [coarse()])
    assert len({sample.fields["pose"]["position"]["x"] for sample in exact.samples}) > 1
    assert {sample.fields["pose"]["position"]["x"] % 2 for sample in rough.samples} <= {0.0, 1.0}


async def test_a_grant_that_comes_and_ends_takes_effect(site: Site, client: PreviewClient) -> None:
    site.publish("/robot", "/pose")
    tasks = TaskSet()
    async with site.node("/robot") as robot:
        tasks.spawn(drive(await robot.publisher("/pose", POSE)), "/pose")
        await asyncio.sleep(0.5)
        assert client.recorded("/pose") is None
        grant = site.subscribe(NAME, "/pose")
        await until_recorded(client, "/pose")
        async with caller(site, "/ca") as office:
            assert (await office("rossec.updateRevocations", site.revoke(grant)))[2] == 1
        await asyncio.sleep(1)
        before = len((await until_recorded(client, "/pose")).messages)
        await asyncio.sleep(0.5)
        assert len((await until_recorded(client, "/pose")).messages) == before
        await tasks.close()


async def test_it_ends_with_the_pages(site: Site) -> None:
    ours, theirs = socket.socketpair()
    running = asyncio.ensure_future(receive(theirs, site.environ))
    await asyncio.sleep(0.1)
    ours.close()
    async with asyncio.timeout(30):
        await running
