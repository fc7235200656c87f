"""A peer with a limited right tries to get more by connecting again, or many times.

The rate of these grants lets one message through, and the next one after a quarter of an hour: so
whatever else arrives was gained by the attack, however slow the machine is.
"""

import asyncio
import contextlib

import pytest

from ca.encoding import encode
from grants.model import Restriction, Right
from rossec.net.aio import connect
from rossec.participant.access import FIELD
from rossec.ros import tcpros
from tests.support.attacker import EVE, HOST
from tests.support.contexts import unlimited
from tests.support.limited import (
    HELD,
    NEAR_A_BOUNDARY,
    ONE_MESSAGE,
    SELDOM,
    SERVICE,
    TOPIC,
    lamp,
    number,
    publishing,
)
from tests.support.site import Site
from tests.support.witness import until


@pytest.mark.attack("more-by-reconnecting")
async def test_a_new_connection_does_not_reset_the_rate(site: Site) -> None:
    async with publishing(site, ONE_MESSAGE) as eve:
        found = []
        for value in range(8):
            stream = await eve.connect()
            eve.publisher.publish_bytes(number(value))
            found += await eve.heard(stream)
        assert found == [[number(0)], *[[]] * 7]


@pytest.mark.attack("more-by-reconnecting")
async def test_many_connections_count_as_one_receiver(site: Site) -> None:
    """They share the messages: each gets them, and together they get no more."""
    async with publishing(site, ONE_MESSAGE) as eve:
        streams = [await eve.connect() for _ in range(10)]
        eve.publisher.publish_bytes(number(0))
        for value in range(1, 11):
            streams.append(await eve.connect())
            eve.publisher.publish_bytes(number(value))
        assert await eve.heard(*streams) == [*[[number(0)]] * 10, *[[]] * 10]


@pytest.mark.attack("more-by-reconnecting")
async def test_a_new_publisher_does_not_reset_the_rate(site: Site) -> None:
    found = []
    for _ in range(3):
        async with publishing(site, ONE_MESSAGE) as eve:
            stream = await eve.connect()
            eve.publisher.publish_bytes(number(1))
            found += await eve.heard(stream)
    assert found == [[number(1)], [], []]


@pytest.mark.attack("more-by-reconnecting")
async def test_another_grant_of_the_same_right_shares_the_rate(site: Site) -> None:
    """The wider one on one connection, the narrower on another: together as much as the wider."""
    wider = Restriction("std_msgs/Float64", (), HELD.filters, rate=SELDOM * 2)
    async with publishing(site, ONE_MESSAGE) as eve:
        first = await eve.connect()
        eve.publisher.publish_bytes(number(0))
        eve.grant = site.subscribe(EVE, TOPIC, wider)
        second = await eve.connect()
        for value in range(1, 4):
            eve.publisher.publish_bytes(number(value))
        assert await eve.heard(first, second) == [[number(0)], []]


@pytest.mark.attack("more-by-reconnecting")
async def test_a_new_connection_does_not_reset_hysteresis(site: Site) -> None:
    """Rounding alone tells on which side of 1 m something is; ten samples make a track."""
    async with publishing(site, HELD) as eve:
        found = []
        for value in NEAR_A_BOUNDARY:
            stream = await eve.connect()
            eve.publisher.publish_bytes(number(value))
            found += await eve.heard(stream)
        assert found == [[number(0)]] * len(NEAR_A_BOUNDARY)


@pytest.mark.attack("more-by-reconnecting")
async def test_a_latched_message_is_not_a_new_sample(site: Site) -> None:
    """A peer that connects again gets the message it had: nothing newer, and no sign of it."""
    async with publishing(site, ONE_MESSAGE, latch=True) as eve:
        for value in range(4):
            eve.publisher.publish_bytes(number(value))
            assert await eve.heard(await eve.connect()) == [[number(0)]]


@pytest.mark.attack("more-by-reconnecting")
async def test_calls_over_many_connections_share_the_rate(site: Site) -> None:
    calls: list[bool] = []
    site.grant(EVE, Right.CALL, SERVICE, restriction=ONE_MESSAGE)
    grants = encode([*site.enroll(EVE).grants()])
    async with lamp(site, calls) as node:
        for persistent in ("0", "1") * 5:
            stream = await connect(
                HOST, node.topic_endpoint()[1], unlimited(site.enroll(EVE).credentials(), site.anchor.verify)
            )
            fields = {
                "callerid": EVE,
                "service": SERVICE,
                "md5sum": "*",
                "persistent": persistent,
                FIELD: grants,
            }
            await stream.send(tcpros.encode(fields))
            async with asyncio.timeout(60):
                assert b"request_type" in await stream.receive()
                await stream.send(tcpros.frame(b"\1"))
                assert await stream.receive()  # the answer, or that there is none
            stream.abort("done")
    assert calls == [True]


@pytest.mark.attack("more-by-reconnecting")
async def test_a_provider_answers_within_its_rate(site: Site) -> None:
    """Its own right is what is limited, and each call is a connection of its own."""
    calls: list[bool] = []
    site.grant("/lamp", Right.PROVIDE, SERVICE, restriction=ONE_MESSAGE)
    site.grant("/viewer", Right.CALL, SERVICE)
    async with lamp(site, calls), site.node("/viewer") as viewer:
        client = viewer.client(SERVICE, "std_srvs/SetBool")
        assert (await client(data=True)).success
        for _ in range(3):
            with contextlib.suppress(Exception):
                await client(data=True)
    assert calls == [True]


@pytest.mark.attack("more-by-reconnecting")
async def test_a_key_that_publishes_under_many_names_has_one_rate(site: Site) -> None:
    """Anonymous nodes share a key; what one of them publishes reaches every subscriber here."""
    site.enroll(EVE, wildcard=True)
    site.grant(EVE, Right.PUBLISH, TOPIC, restriction=ONE_MESSAGE)
    site.subscribe("/viewer", TOPIC)
    site.subscribe("/viewer", "/control")
    site.publish("/robot", "/control")
    async with contextlib.AsyncExitStack() as stack:
        viewer = await stack.enter_async_context(site.node("/viewer"))
        seen = [await viewer.subscriber(TOPIC, "std_msgs/Float64") for _ in range(2)]
        for place in range(4):
            node = await stack.enter_async_context(site.node(f"{EVE}_{place}"))
            publisher = await node.publisher(TOPIC, "std_msgs/Float64")
            await publisher.wait_for_subscribers(2)
            publisher.publish_bytes(number(place))
            links = tuple(publisher.links)
            await until(lambda: not any(queue._queue for queue in publisher.links.values()))  # noqa: B023 - at once
            for link in links:
                await link.stream.close()
            await until(lambda: not publisher.links)  # noqa: B023 - at once
        assert [subscriber.received for subscriber in seen] == [1, 1]
