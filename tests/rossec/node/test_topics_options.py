"""DeliveryOptions between nodes over real sockets: taken, refused, and unknown to an older peer."""

import asyncio
from typing import Any, Final

import pytest

from grants.model import Restriction, filter_rules
from rossec.errors import ConfigurationError, ConnectionHeaderRefused
from rossec.node import Node, Publisher, node
from rossec.node import subscriber as subscribing
from rossec.participant import handshakes
from rossec.participant.delivery_options import NO_OPTIONS, DeliveryOptions, DeliveryQueue
from tests.support.site import Site
from tests.support.witness import until

TOPIC: Final = "/robot/words"
TYPE: Final = "std_msgs/String"
WORDS: Final = [f"{number} {'again and again ' * 3000}" for number in range(5)]


def prepare(site: Site, restriction: Restriction | None = None) -> tuple[Node, Node]:
    site.publish("/robot", TOPIC)
    site.subscribe("/viewer", TOPIC, restriction)
    return site.node("/robot"), site.node("/viewer")


async def publishing(robot: Node) -> Publisher:
    return await robot.publisher(TOPIC, TYPE, queue_size=100)


def say(publisher: Publisher, *words: str) -> None:
    for word in words:
        publisher.publish(publisher.create(data=word))


async def heard(subscriber: Any, count: int) -> list[str]:
    found: list[str] = []
    async with asyncio.timeout(30):
        async for message in subscriber:
            found.append(message.data)
            if len(found) == count:
                break
    return found


async def test_deflated_messages_arrive_as_they_were_sent(site: Site) -> None:
    robot, viewer = prepare(site)
    async with robot, viewer:
        publisher = await publishing(robot)
        subscriber = await viewer.subscriber(TOPIC, TYPE, deflate=True)
        await publisher.wait_for_subscribers()
        say(publisher, *WORDS)
        assert await heard(subscriber, 5) == WORDS
        (queue,) = publisher.links.values()
        assert isinstance(queue, DeliveryQueue)


async def test_what_is_filtered_is_not_deflated(site: Site) -> None:
    """Its length would tell what the filter left; the option is not taken, and messages come."""
    rules = filter_rules({"data": {"truncate": {"length": 1}}})
    robot, viewer = prepare(site, Restriction(TYPE, (), rules))
    async with robot, viewer:
        publisher = await publishing(robot)
        subscriber = await viewer.subscriber(TOPIC, TYPE, deflate=True, newest=True)
        await publisher.wait_for_subscribers()
        (queue,) = publisher.links.values()
        assert isinstance(queue, DeliveryQueue)
        assert (queue.newest, queue._deflate, queue._rate) == (True, False, None)
        say(publisher, WORDS[3])
        assert await heard(subscriber, 1) == ["3"]


async def test_a_rate_is_kept_by_the_publisher(site: Site) -> None:
    robot, viewer = prepare(site)
    async with robot, viewer:
        publisher = await publishing(robot)
        subscriber = await viewer.subscriber(TOPIC, TYPE, rate=0.001)
        await publisher.wait_for_subscribers()
        say(publisher, "one", "two", *WORDS)
        assert await heard(subscriber, 2) == ["one", "two"]
        (queue,) = publisher.links.values()
        assert isinstance(queue, DeliveryQueue)
        assert queue.thinned == 5


async def test_an_older_publisher_ignores_them(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(node, "requested_options", lambda _: NO_OPTIONS)
    robot, viewer = prepare(site)
    async with robot, viewer:
        publisher = await publishing(robot)
        subscriber = await viewer.subscriber(TOPIC, TYPE, rate=0.001, newest=True, deflate=True)
        await publisher.wait_for_subscribers()
        say(publisher, "one", "two", *WORDS)
        assert await heard(subscriber, 2) == ["one", "two"]
        (queue,) = publisher.links.values()
        assert not isinstance(queue, DeliveryQueue)


async def test_a_publisher_that_does_what_was_not_asked_is_refused(
    site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(node, "requested_options", lambda _: DeliveryOptions(deflate=True))
    robot, viewer = prepare(site)
    async with robot, viewer:
        await publishing(robot)
        subscriber = await viewer.subscriber(TOPIC, TYPE)
        await until(lambda: subscriber.refusals)
        assert isinstance(subscriber.refusals[0], ConnectionHeaderRefused)
        assert "was not asked to" in str(subscriber.refusals[0])


async def test_a_malformed_wish_is_refused(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    written = handshakes.subscriber_header

    def forged(*arguments: Any) -> dict[str, bytes]:
        return {**written(*arguments), "rossec_rate": b"1e9"}

    monkeypatch.setattr(subscribing, "subscriber_header", forged)
    robot, viewer = prepare(site)
    async with robot, viewer:
        await publishing(robot)
        subscriber = await viewer.subscriber(TOPIC, TYPE)
        await until(lambda: subscriber.refusals)
        assert "'rossec_rate' is no rate" in str(subscriber.refusals[0])


async def test_a_wish_for_no_rate_at_all_is_the_callers_mistake(site: Site) -> None:
    _, viewer = prepare(site)
    async with viewer:
        with pytest.raises(ConfigurationError, match="a rate of 0 messages"):
            await viewer.subscriber(TOPIC, TYPE, rate=0)
