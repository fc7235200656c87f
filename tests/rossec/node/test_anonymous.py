"""Anonymous nodes: one certified wildcard, several nodes, a real master and real sockets."""

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from ca.errors import NameCovered, RevocationsStale
from rossec.errors import ConfigurationError
from rossec.node import Node
from tests.support.site import Site
from tests.support.witness import POSE, until

TOPIC = "/robot/pose"


@pytest.fixture
async def site(tmp_path: Path) -> AsyncIterator[Site]:
    """A site with an identity for `/rviz_*` that may publish and subscribe."""
    async with Site(tmp_path / "site").running() as site:
        site.enroll("/rviz", wildcard=True)
        site.publish("/rviz", TOPIC)
        site.subscribe("/rviz", TOPIC)
        yield site


async def test_two_nodes_of_one_identity_communicate(site: Site) -> None:
    one, two = site.node("/rviz_1234_1700000000000"), site.node("/rviz_2_x")
    async with one, two:
        publisher = await one.publisher(TOPIC, POSE)
        subscriber = await two.subscriber(TOPIC, POSE)
        await publisher.wait_for_subscribers()
        publisher.publish(publisher.create())
        async with asyncio.timeout(30):
            await anext(aiter(subscriber))
        state = await two._membership.session.call("getSystemState")
        assert state == [[[TOPIC, [one.name]]], [[TOPIC, [two.name]]], []]
        assert await one._membership.session.call("lookupNode", two.name) == two.uri


async def test_an_anonymous_node_receives_from_another_node(site: Site) -> None:
    site.publish("/robot", TOPIC)
    async with site.node("/robot") as robot, site.node("/rviz_1") as rviz:
        await rviz.subscriber(TOPIC, POSE)
        publisher = await robot.publisher(TOPIC, POSE)
        await publisher.wait_for_subscribers()


async def test_remapping_the_name_finds_the_same_identity(site: Site) -> None:
    node = Node("/something", argv=["__name:=rviz_7"], environ=site.environ)
    assert (node.name, node.identity.name) == ("/rviz_7", "/rviz")
    with pytest.raises(ConfigurationError, match=r"/robot/rviz_7 has no ca\.pem"):
        Node("/something", argv=["__name:=rviz_7", "__ns:=/robot"], environ=site.environ)


async def test_closing_a_node_does_not_affect_another_of_its_identity(site: Site) -> None:
    async with site.node("/rviz_1") as one, site.node("/rviz_2") as two:
        publisher = await one.publisher(TOPIC, POSE)
        await two.publisher(TOPIC, POSE)
        await two.close()
        state = await one._membership.session.call("getSystemState")
        assert state == [[[TOPIC, [one.name]]], [], []]
        assert publisher.topic == TOPIC


async def test_revoking_an_identity_ends_all_its_nodes(site: Site) -> None:
    site.publish("/robot", TOPIC)
    async with site.node("/robot") as robot, site.node("/rviz_1") as one, site.node("/rviz_2") as two:
        publisher = await robot.publisher(TOPIC, POSE)
        for node in (one, two):
            await node.subscriber(TOPIC, POSE)
        await publisher.wait_for_subscribers(2)
        revoked = site.revoke(site.identity("/rviz").thumbprint)
        await robot._membership.session.call("rossec.updateRevocations", revoked)
        await until(lambda: not publisher.links)
        with pytest.raises(RevocationsStale, match="the revocation list without a timestamp"):
            await site.node("/rviz_3")._membership.session.open()


async def test_a_name_that_a_wildcard_covers_cannot_be_enrolled(site: Site) -> None:
    with pytest.raises(NameCovered):
        site.enroll("/rviz_1")
