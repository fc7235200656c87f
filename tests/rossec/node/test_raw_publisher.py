"""A topic whose type is described later: what its subscribers wait for, receive and are refused."""

import asyncio
from pathlib import Path

import pytest

from grants.errors import DefinitionRefused
from grants.model import Restriction, Right, filter_rules
from grants.token import peek
from rossec.errors import ConfigurationError, NodeShutdown
from rossec.node import Node, Subscriber
from rossec.node import publisher as publisher_module
from rossec.node.publisher import RawPublisher
from rossec.participant.definitions import Definition, from_header
from rossec.participant.message_types import message_type
from tests.support.site import Site
from tests.support.witness import until

TYPE = "std_msgs/String"
STRING = message_type(TYPE)


def text(data: str) -> bytes:
    return len(data).to_bytes(4, "little") + data.encode()


async def forwarded(node: Node, topic: str = "/said") -> tuple[RawPublisher, list[int]]:
    """A raw publisher, and its demand each time it changed."""
    demand: list[int] = []
    made = await node.topics.publish_raw(topic, TYPE, lambda: demand.append(made.demand), queue_size=10)
    return made, demand


async def texts(subscriber: Subscriber, count: int) -> list[str]:
    found = []
    async with asyncio.timeout(20):
        async for message in subscriber:
            found.append(message.data)
            if len(found) == count:
                break
    return found


async def test_a_subscriber_waits_until_the_type_is_known(site: Site) -> None:
    site.publish("/box", "/said")
    site.subscribe("/viewer", "/said")
    async with site.node("/box") as box, site.node("/viewer") as viewer:
        publisher, demand = await forwarded(box)
        subscriber = await viewer.subscriber("/said", TYPE)
        await until(lambda: publisher.demand == 1, within=20)
        assert not publisher._known.is_set()
        assert not publisher.links
        publisher.describe(STRING)
        await until(lambda: bool(publisher.links), within=20)
        publisher.forward("one", text("hello"), keep=False)
        assert await texts(subscriber, 1) == ["hello"]
        await subscriber.close()
        await until(lambda: publisher.demand == 0, within=20)
        assert demand[0] == 1
        assert demand[-1] == 0


async def test_a_definition_with_comments_in_another_encoding_is_passed_on(site: Site) -> None:
    """ROS hands on whatever bytes a .msg file has; another domain may send any."""
    site.publish("/box", "/said")
    site.subscribe("/viewer", "/said")
    latin = from_header(
        {
            "type": TYPE.encode(),
            "md5sum": STRING.md5sum.encode(),
            "message_definition": b"string data  # 20 \xb0C\n",
        }
    )
    async with site.node("/box") as box, site.node("/viewer") as viewer:
        publisher, _ = await forwarded(box)
        publisher.describe(latin)
        subscriber = await viewer.subscriber("/said", TYPE)
        await publisher.wait_for_subscribers()
        publisher.forward("one", text("hello"), keep=False)
        assert await texts(subscriber, 1) == ["hello"]


async def test_a_right_that_ends_while_a_handshake_waits_is_worth_nothing(site: Site) -> None:
    site.publish("/box", "/said")
    right = site.subscribe("/viewer", "/said")
    async with site.node("/box") as box, site.node("/viewer") as viewer:
        publisher, _ = await forwarded(box)
        subscriber = await viewer.subscriber("/said", TYPE)
        await until(lambda: publisher.demand == 1, within=20)
        await box._membership.session.call("rossec.updateRevocations", site.revoke(right))
        await until(lambda: peek(right).id in box.access._revocations.entries, within=20)
        publisher.describe(STRING)
        publisher.forward("one", text("hello"), keep=True)
        await until(lambda: publisher.demand == 0, within=20)
        assert not publisher.links
        assert subscriber.received == 0


async def test_a_handshake_does_not_wait_for_ever(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(publisher_module, "PATIENCE", 0.05)
    site.publish("/box", "/said")
    site.subscribe("/viewer", "/said")
    async with site.node("/box") as box, site.node("/viewer") as viewer:
        publisher, _ = await forwarded(box)
        subscriber = await viewer.subscriber("/said", TYPE)
        await until(lambda: bool(subscriber.refusals), within=20)
        assert "no publisher of /said can be reached" in str(subscriber.refusals[0])
        publisher.describe(STRING)
        await publisher.wait_for_subscribers()


async def test_a_new_subscriber_is_sent_the_last_message_of_each_sender(site: Site) -> None:
    site.publish("/box", "/said")
    site.subscribe("/viewer", "/said")
    async with site.node("/box") as box, site.node("/viewer") as viewer:
        publisher, _ = await forwarded(box)
        publisher.describe(STRING)
        for sender, data in (("a", "old"), ("a", "new"), ("b", "other"), ("c", "gone")):
            publisher.forward(sender, text(data), keep=True)
        publisher.forward("d", text("not kept"), keep=False)
        publisher.forget("c")
        publisher.forget("nobody")
        first = await viewer.subscriber("/said", TYPE)
        assert await texts(first, 2) == ["new", "other"]


async def test_a_subscribers_restrictions_hold_by_the_senders_definition(tmp_path: Path) -> None:
    site = Site(tmp_path / "site")
    rules = filter_rules({"data": {"truncate": {"length": 4}}})
    site.publish("/box", "/said")
    site.grant("/viewer", Right.SUBSCRIBE, "/said", restriction=Restriction(TYPE, (), rules))
    async with site.running(), site.node("/box") as box, site.node("/viewer") as viewer:
        publisher, _ = await forwarded(box)
        publisher.describe(STRING)
        publisher.forward("a", text("hello"), keep=True)
        assert await texts(await viewer.subscriber("/said", TYPE), 1) == ["hell"]


async def test_a_definition_that_cannot_be_checked_admits_no_restricted_subscriber(tmp_path: Path) -> None:
    site = Site(tmp_path / "site")
    rules = filter_rules({"data": {"truncate": {"length": 4}}})
    site.publish("/box", "/said")
    site.grant("/viewer", Right.SUBSCRIBE, "/said", restriction=Restriction(TYPE, (), rules))
    async with site.running(), site.node("/box") as box, site.node("/viewer") as viewer:
        publisher, _ = await forwarded(box)
        publisher.describe(Definition(TYPE, STRING.md5sum, "no definition!"))
        subscriber = await viewer.subscriber("/said", TYPE)
        await until(lambda: bool(subscriber.refusals), within=20)
        assert not publisher.links
        assert not isinstance(subscriber.refusals[0], DefinitionRefused)  # the answer says it


async def test_what_is_published_no_longer_is_unregistered_and_cut(site: Site) -> None:
    site.publish("/box", "/said")
    site.subscribe("/viewer", "/said")
    async with site.node("/box") as box, site.node("/viewer") as viewer:
        publisher, _ = await forwarded(box)
        publisher.describe(STRING)
        subscriber = await viewer.subscriber("/said", TYPE)
        await publisher.wait_for_subscribers()
        await box.topics.unpublish(publisher)
        await until(lambda: not subscriber.links and not publisher.links, within=20)
        with pytest.raises(NodeShutdown):
            publisher.forward("a", text("late"), keep=False)
        await box.topics.unpublish(publisher)  # safe to call twice
        again, _ = await forwarded(box)
        again.describe(STRING)
        await again.wait_for_subscribers()


async def test_who_waits_for_a_topic_that_is_withdrawn_is_refused(site: Site) -> None:
    site.publish("/box", "/said")
    site.subscribe("/viewer", "/said")
    async with site.node("/box") as box, site.node("/viewer") as viewer:
        publisher, _ = await forwarded(box)
        subscriber = await viewer.subscriber("/said", TYPE)
        await until(lambda: publisher.demand == 1, within=20)
        await box.topics.unpublish(publisher)
        await until(lambda: bool(subscriber.refusals), within=20)
        assert "is published no longer" in str(subscriber.refusals[0])


async def test_a_topic_has_one_publisher_in_a_node(site: Site) -> None:
    site.publish("/box", "/said")
    async with site.node("/box") as box:
        await forwarded(box)
        with pytest.raises(ConfigurationError, match="published by this node already"):
            await forwarded(box)
