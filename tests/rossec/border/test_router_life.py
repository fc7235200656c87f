"""Things come, leave, fall silent and change their key; the master is restarted."""

from collections.abc import AsyncIterator

import pytest
from aiocoap.numbers import codes

from ca.encoding import encode
from rossec.border import border_router as routers
from rossec.errors import DatagramRefused, NodeShutdown
from tests.support.border import LAMP, BorderSite
from tests.support.rawthing import RawThing
from tests.support.site import Site
from tests.support.witness import until

TOPIC = f"{LAMP}/temperature"
LINKS = b'</t>;rt="ros.pub";if="std_msgs/Float32";title="~temperature";ct=60'


@pytest.fixture
async def border(site: Site) -> AsyncIterator[BorderSite]:
    async with BorderSite(site).running() as found:
        yield found


@pytest.fixture
async def lamp(border: BorderSite) -> AsyncIterator[RawThing]:
    """A lamp that is registered, and published."""
    thing = await started(border)
    border.allow()
    assert await thing.register()
    await until(lambda: LAMP in border.router.bridges and border.router.bridges[LAMP].received)
    yield thing
    thing.close()


async def started(border: BorderSite, links: bytes = LINKS) -> RawThing:
    thing = RawThing(border.address, border.key.credential, links, state=encode({"data": 1.5}))
    border.state(LAMP, thing.credential)
    await thing.start()
    return thing


async def test_a_thing_that_leaves(border: BorderSite, lamp: RawThing) -> None:
    assert await lamp.request(codes.DELETE, ("rd",)) == codes.DELETED
    await until(lambda: LAMP not in border.router.bridges)
    assert not border.router.server.endpoint.conversations.all()
    assert await lamp.register()
    await until(lambda: LAMP in border.router.bridges)


async def test_a_thing_that_is_silent_for_very_long(
    border: BorderSite, lamp: RawThing, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert lamp.received
    monkeypatch.setattr(routers, "SILENT", -1.0)
    await until(lambda: LAMP not in border.router.bridges)


async def test_a_master_that_restarts_learns_of_every_thing(
    border: BorderSite, lamp: RawThing, site: Site
) -> None:
    site.subscribe("/heating", TOPIC)
    await site.restart_master()
    async with site.node("/heating") as node:
        seen = await node.subscriber(TOPIC, "std_msgs/Float32")
        await until(lambda: seen.links, within=30)
        lamp.notify(encode({"data": 2.5}))
        assert (await anext(aiter(seen))).data == 2.5


async def test_another_device_under_the_same_name(border: BorderSite, lamp: RawThing) -> None:
    before = border.router.bridges[LAMP]
    await border.revoke(border.roster_statement(LAMP).id)
    other = await started(border)
    assert await other.register()
    await until(lambda: border.router.bridges.get(LAMP) not in {None, before})
    assert border.router.bridges[LAMP].credential == other.credential.thumbprint
    with pytest.raises(DatagramRefused):
        await lamp.request(codes.POST, ("rd",))
    other.close()


async def test_a_list_that_is_malformed_is_logged(
    border: BorderSite, caplog: pytest.LogCaptureFixture
) -> None:
    thing = await started(border, b"no links")
    assert await thing.register()
    await until(lambda: f"{LAMP}: not a list of links" in caplog.text)
    thing.links = LINKS
    border.allow()
    assert await thing.request(codes.POST, ("rd",)) == codes.CHANGED
    await until(lambda: border.router.bridges[LAMP].resources)
    await until(lambda: border.router.bridges[LAMP].received, within=30)
    thing.close()


async def test_the_router_ends_with_its_node(border: BorderSite) -> None:
    border.router.node.shutdown_requested("a test")
    with pytest.raises(NodeShutdown, match="a test"):
        await border.router.wait_ended()
