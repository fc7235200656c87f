"""Topics whose messages are bytes of any type: registered, forwarded, withdrawn."""

import contextlib
from collections.abc import Sequence

import pytest

from rossec.errors import AnswerRefused, ConfigurationError
from rossec.node import message_type
from rossec.node.subscriber import RawSource
from tests.support.site import Site
from tests.support.witness import until

TYPE = "std_msgs/String"


class Taken:
    """What a raw subscriber hands on."""

    def __init__(self) -> None:
        self.messages: list[bytes] = []

    def connected(self, source: RawSource) -> None:
        pass

    def received(self, _: RawSource, messages: Sequence[bytes]) -> None:
        self.messages += messages

    def disconnected(self, source: RawSource) -> None:
        pass

    def refused(self, error: Exception) -> None:
        pass


async def test_bytes_pass_from_one_to_the_other_until_they_are_withdrawn(site: Site) -> None:
    site.publish("/box", "/said")
    site.subscribe("/reader", "/said")
    taken = Taken()
    assert site.master is not None
    async with site.node("/box") as box, site.node("/reader") as reader:
        made = await box.topics.publish_raw("/said", TYPE, lambda: None, queue_size=10)
        made.describe(message_type(TYPE))
        subscriber = await reader.topics.subscribe_raw("/said", taken)
        await made.wait_for_subscribers()
        made.forward("one", b"\x02\0\0\0hi", keep=False)
        await until(lambda: taken.messages == [b"\x02\0\0\0hi"])
        assert box.topics.publishers == {"/said": made}
        assert reader.topics.subscribers == [subscriber]
        assert box.topics.describe()["getPublications"] == [["/said", TYPE]]
        await site.restart_master()
        registry = site.master.state.registry
        await until(lambda: bool(registry.publisher_uris("/said")))
        await box.topics.unpublish(made)
        assert registry.publisher_uris("/said") == []
        await until(lambda: not subscriber.links)
        await subscriber.close()
        assert reader.topics.subscribers == []


async def test_what_the_master_refuses_is_neither_published_nor_subscribed(site: Site) -> None:
    async with site.node("/box") as box:
        with pytest.raises(AnswerRefused, match="publish"):
            await box.topics.publish_raw("/said", TYPE, lambda: None, queue_size=10)
        with pytest.raises(AnswerRefused, match="subscribe"):
            await box.topics.subscribe_raw("/said", Taken())
        with pytest.raises(ConfigurationError, match="/remote"):
            await box.topics.publish_raw("/remote/a/b", TYPE, lambda: None, queue_size=10)
        assert (box.topics.publishers, box.topics.subscribers) == ({}, [])
        with contextlib.suppress(AnswerRefused):
            await box.topics.restore()
