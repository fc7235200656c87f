"""The ROS node of a thing."""

import asyncio
import contextlib
from collections.abc import AsyncIterator

import pytest

from ca.certificates import Identity
from rossec import clock
from rossec.border.constrained_node import SharedIdentity, ThingNode
from rossec.errors import ConfigurationError
from rossec.node import Node
from rossec.ros.names import REVOCATION_UPDATE
from tests.support.border import LAMP
from tests.support.site import Site
from tests.support.witness import until

TOPIC = f"{LAMP}/temperature"
FLOAT = "std_msgs/Float32"


def shared_by(node: Node) -> SharedIdentity:
    """What things share with the router's node."""
    return SharedIdentity(
        node.access.trust_status,
        node.settings,
        node.push_arrived,
        lambda: node.revocations.data,
        node.home.save_revocations,
        master=node.master_name,
    )


@contextlib.asynccontextmanager
async def thing_node(site: Site, name: str = LAMP) -> AsyncIterator[ThingNode]:
    """A thing's node, beside that of a router."""
    async with site.node("/border") as border:
        node = ThingNode(site.enroll(name), shared_by(border), "127.0.0.1")
        await node.start()
        yield node
        await node.close("the test ends")
        await node._shared.tasks.close()


async def test_it_publishes_and_leaves_the_master(site: Site) -> None:
    site.publish(LAMP, TOPIC)
    site.subscribe("/heating", TOPIC)
    async with thing_node(site) as node, site.node("/heating") as heating:
        publisher = await node.publish(TOPIC, FLOAT)
        assert node._visits.is_open
        await until(lambda: not node._visits.is_open)
        seen = await heating.subscriber(TOPIC, FLOAT)
        await publisher.wait_for_subscribers()
        publisher.publish(publisher.create(data=1.5))
        assert (await anext(aiter(seen))).data == 1.5
        assert len(tuple(node.connections)) == 1
        await node.unpublish(TOPIC)
        await until(lambda: not seen.links)


async def test_it_registers_again_with_new_grants(site: Site) -> None:
    site.publish(LAMP, TOPIC)
    async with thing_node(site) as node:
        await node.publish(TOPIC, FLOAT)
        assert not node._is_old(clock.now())
        site.subscribe(LAMP, "/orders")
        assert node.is_due(clock.now())
        assert not node._is_old(clock.now())
        await site.restart_master()
        await node.update()
        assert site.master is not None
        subscriber = await node.subscribe("/orders", FLOAT)
        assert subscriber.topic == "/orders"
        node.publishers_changed("/orders", [])
        node.parameter_changed("/x", 1)
        node.maintain(clock.now())


async def test_a_master_that_is_out_of_reach_is_logged(site: Site, caplog: pytest.LogCaptureFixture) -> None:
    async with thing_node(site) as node:
        assert site.master is not None
        await site.master.close()
        site.master = None
        await node.update()
        assert f"{LAMP}: grants" in caplog.text


async def test_the_identity_is_renewed_when_it_is_due(site: Site) -> None:
    async with thing_node(site) as node:
        node._renew_at = 0
        assert node.is_due(clock.now())
        await node.update()  # the master has no intermediate: refused, tried again later
        assert not node._is_old(clock.now())
        assert node._is_old(clock.now() - 86400), "a clock that was ahead is no reason to wait"
        site.renew(LAMP, 2 * 86400)
        before = node._not_after
        node._renew_at = 0
        node._load(clock.now())
        assert node._not_after > before


async def test_what_the_master_pushes_is_for_all(site: Site) -> None:
    taken: list[str] = []
    async with thing_node(site) as node:
        shared = node._shared
        object.__setattr__(shared, "take_push", lambda method, *_: taken.append(method))
        master = site.identity("/master")
        assert isinstance(master, Identity)
        node.push_arrived(REVOCATION_UPDATE, (b"", b"timestamp"), master)
        assert taken == []
        node.push_arrived(REVOCATION_UPDATE, (b"list", b"timestamp"), master)
        node.push_arrived("rossec.domainsUpdate", (b"",), master)
        assert taken == ["rossec.revocationUpdate", "rossec.domainsUpdate"]
        assert node.describe()["getName"] == LAMP
        node.shutdown_requested("another one has its name")
        await until(lambda: node.closed)
        await asyncio.sleep(0)


async def test_a_node_of_another_authority_is_refused(
    site: Site, tmp_path_factory: pytest.TempPathFactory
) -> None:
    other = Site(tmp_path_factory.mktemp("other") / "site")
    async with site.node("/border") as border:
        with pytest.raises(ConfigurationError, match="another authority"):
            ThingNode(other.enroll(LAMP), shared_by(border), "127.0.0.1")
