"""A node receives its own topics and calls its own services, as ROS programs often do."""

import asyncio
from pathlib import Path

from grants.model import Right
from rossec.participant.message_types import Message
from tests.support.site import Site
from tests.support.witness import until

TOPIC, SERVICE, STRING, TRIGGER = "/loop", "/echo", "std_msgs/String", "std_srvs/Trigger"


def grant_all(site: Site, name: str) -> None:
    site.publish(name, TOPIC)
    site.subscribe(name, TOPIC)
    site.grant(name, Right.PROVIDE, SERVICE)
    site.grant(name, Right.CALL, SERVICE)


async def test_a_node_uses_its_own_topic_and_service(tmp_path: Path) -> None:
    site = Site(tmp_path / "site")
    grant_all(site, "/robot")

    async def answer(_: Message) -> dict[str, object]:
        return {"success": True, "message": "called itself"}

    async with site.running(), site.node("/robot") as robot, asyncio.timeout(60):
        subscriber = await robot.subscriber(TOPIC, STRING)
        publisher = await robot.publisher(TOPIC, STRING)
        await publisher.wait_for_subscribers()
        publisher.publish(publisher.create(data="to itself"))
        assert (await anext(subscriber.messages())).data == "to itself"
        (connection,) = publisher.links
        assert connection.stream.peer.name == "/robot"
        await robot.service(SERVICE, TRIGGER, answer)
        await robot.wait_for_service(SERVICE, timeout=30)
        for persistent in (False, True):
            async with robot.client(SERVICE, TRIGGER, persistent=persistent) as client:
                assert (await client()).message == "called itself"


async def test_a_node_needs_the_right_for_its_own_topic(tmp_path: Path) -> None:
    site = Site(tmp_path / "site")
    site.subscribe("/robot", TOPIC)
    async with site.running(), site.node("/robot") as robot:
        subscriber = await robot.subscriber(TOPIC, STRING)
        subscriber.update([robot.uri])
        await until(lambda: subscriber.refusals)
        assert not subscriber.links
