"""A restarted master: a node that reconnects first keeps its connections."""

from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from rossec.master.state.registry import Kind
from tests.support.blocked import BlockedNodes
from tests.support.site import Site
from tests.support.witness import TOPIC, undisturbed, until


@pytest.fixture
async def site(tmp_path: Path) -> AsyncIterator[Site]:
    async with Site(tmp_path / "site").running() as site:
        yield site


def registered(site: Site, kind: Kind) -> list[str]:
    assert site.master is not None
    return [node.name for node in site.master.state.registry.registered_nodes(kind, TOPIC)]


async def test_a_subscriber_that_reconnects_first_keeps_its_connections(
    site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every message arrives, over the same connection (`undisturbed`)."""
    absent = BlockedNodes(monkeypatch)
    async with undisturbed(site) as witness:
        absent.names = {"/robot"}
        await site.restart_master()
        await until(lambda: registered(site, Kind.SUBSCRIBER) == ["/viewer"])
        await until(lambda: absent.tries > 2)
        await witness.goes_on()
        absent.names = set()
        await until(lambda: registered(site, Kind.PUBLISHER) == ["/robot"])
        await witness.goes_on()


async def test_a_publisher_that_unregisters_is_dropped_at_once(
    site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    site.publish("/robot", TOPIC)
    site.subscribe("/viewer", TOPIC)
    async with site.node("/viewer") as viewer:
        sight = await viewer.subscriber(TOPIC, "std_msgs/String")
        async with site.node("/robot") as robot:
            await robot.publisher(TOPIC, "std_msgs/String")
            await until(lambda: sight.links)
            await site.restart_master()
            await until(lambda: registered(site, Kind.PUBLISHER) == ["/robot"])
            await until(lambda: registered(site, Kind.SUBSCRIBER) == ["/viewer"])
            await until(lambda: not viewer.topics._grace._missing)
            uri = robot.uri
            await robot._membership.session.call("unregisterPublisher", TOPIC, uri)
            await until(lambda: not sight.links)
            assert uri not in sight._tasks
