"""What a subscriber accepts from a publisher whose right is restricted."""

from pathlib import Path

import pytest

from grants.model import Restriction, Right, filter_rules
from tests.support.gateways import ALIAS, SERVED, two_sites
from tests.support.site import Site
from tests.support.witness import until

TYPE = "std_msgs/String"


async def test_the_restrictions_of_a_publisher_are_applied_by_the_subscriber(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """The publisher does not apply the restrictions to itself."""
    site = Site(tmp_path / "site")
    rules = filter_rules({"data": {"truncate": {"length": 4}}})
    restriction = Restriction(TYPE, ('msg.data != "stop"',), rules)
    site.grant("/boss", Right.PUBLISH, "/order", restriction=restriction)
    site.subscribe("/robot", "/order")
    async with site.running(), site.node("/boss") as boss, site.node("/robot") as robot:
        subscriber = await robot.subscriber("/order", TYPE)
        publisher = await boss.publisher("/order", TYPE)
        await publisher.wait_for_subscribers()
        for data in ("stop", "go on"):
            publisher.publish(publisher.create(data=data))
        for _ in range(5):
            publisher.publish_bytes(b"\x02\0\0\0go, and a tail")
        publisher.publish(publisher.create(data="end"))
        words = []
        async for message in subscriber:
            words.append(message.data)
            if len(words) == 2:
                break
        assert words == ["go o", "end"]
    assert caplog.text.count("/order: withheld a message of /boss") == 1


async def test_a_restriction_for_another_type_refuses_the_publisher(tmp_path: Path) -> None:
    site = Site(tmp_path / "site")
    restriction = Restriction("geometry_msgs/Twist", ("msg.linear.x < 1.0",))
    site.grant("/boss", Right.PUBLISH, "/order", restriction=restriction)
    site.subscribe("/robot", "/order")
    async with site.running(), site.node("/boss") as boss, site.node("/robot") as robot:
        await boss.publisher("/order", TYPE, latch=True)
        subscriber = await robot.subscriber("/order", TYPE)
        await until(lambda: bool(subscriber.refusals), within=20)
        assert "restricted for messages of type geometry_msgs/Twist" in str(subscriber.refusals[0])


async def test_of_an_alias_a_gateway_is_asked_for_what_it_serves(tmp_path: Path) -> None:
    """The subscriber has the right at home alone; it is told so by the master, and left too."""
    async with two_sites(tmp_path) as sites, sites.home.node("/gateway") as gateway:
        publisher = await gateway.publisher(SERVED, TYPE, latch=True)
        publisher.publish(publisher.create(data="hello"))
        async with sites.home.node("/viewer") as viewer:
            subscriber = await viewer.subscriber(ALIAS, TYPE)
            async for message in subscriber:
                assert message.data == "hello"
                break
            [link] = publisher.links
            assert link.decision.name == SERVED
            assert subscriber.topic == ALIAS
            subscriber.update([])
            await until(lambda: not publisher.links)
