"""Receivers try to undo what a preset does: two compare what they have, one connects at the moment.

What programs get out of the presets in an hour is measured: `python -m bench privacy`, with bounds
in tests/bench/test_privacy.py. Here are the attacks that need real connections.
"""

import contextlib

import pytest

from grants.model import Restriction, filter_rules
from tests.support.limited import number, publishing
from tests.support.site import Site

NAMES = "/robot/names"
ONE_RECEIVER = Restriction(
    "std_msgs/String", (), filter_rules({"data": {"hash": {"key": "ward", "per": "receiver"}}})
)
A_DAY = Restriction("std_msgs/Float64", (), filter_rules({"data": {"clear": True}}), slot=86_400)


@pytest.mark.attack("undone-presets")
async def test_two_receivers_cannot_link_their_pseudonyms(site: Site) -> None:
    """Also where they are sent the same message, which is filtered once for equal grants."""
    site.publish("/robot", NAMES)
    told: dict[str, list[str]] = {}
    async with contextlib.AsyncExitStack() as stack:
        robot = await stack.enter_async_context(site.node("/robot"))
        publisher = await robot.publisher(NAMES, "std_msgs/String")
        subscribers = {}
        for receiver in ("/one", "/two"):
            site.subscribe(receiver, NAMES, ONE_RECEIVER)
            node = await stack.enter_async_context(site.node(receiver))
            subscribers[receiver] = await node.subscriber(NAMES, "std_msgs/String")
        await publisher.wait_for_subscribers(2)
        for name in ("Anna", "Bert", "Anna"):
            publisher.publish(publisher.create(data=name))
        for receiver, subscriber in subscribers.items():
            messages = aiter(subscriber)
            told[receiver] = [(await anext(messages)).data for _ in range(3)]
    for first, second, third in told.values():
        assert first == third != second, "one receiver recognises what comes again"
    assert not set(told["/one"]) & set(told["/two"])


@pytest.mark.attack("undone-presets")
async def test_connecting_at_the_moment_shows_no_moment(site: Site) -> None:
    """The first message after a pause is not told, nor to a new connection that waits for it."""
    async with publishing(site, A_DAY, latch=True) as eve:
        streams = [await eve.connect() for _ in range(3)]
        for value in range(4):
            eve.publisher.publish_bytes(number(value))
        assert await eve.heard(*streams) == [[], [], []]
        for value in range(4):
            eve.publisher.publish_bytes(number(value))
            assert await eve.heard(await eve.connect()) == [[]]
