"""The border router with things of aiocoap, ROS nodes and a master, all real, over `::1`."""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable

import pytest
from aiocoap.oscore import NotAProtectedMessage

from ca.encoding import decode, encode
from ca.things import ThingKey
from grants.model import Right
from rossec.node import Node
from tests.support.border import LAMP, BorderSite
from tests.support.constrained import SecretThing, Thing, Value
from tests.support.site import Site

DEADLINE = 20.0


@pytest.fixture
async def border(site: Site) -> AsyncIterator[BorderSite]:
    """A border router that runs."""
    async with BorderSite(site).running() as found:
        yield found


async def until(condition: Callable[[], object], within: float = DEADLINE) -> None:
    """Return as soon as the condition is true."""
    async with asyncio.timeout(within):
        while not condition():  # noqa: ASYNC110 - a state of others, without an event
            await asyncio.sleep(0.02)


async def refused(thing: Thing | SecretThing) -> bool:
    """Whether the router refuses the thing; its answer is not protected."""
    try:
        await thing.register()
    except NotAProtectedMessage:
        return True
    return False


@contextlib.asynccontextmanager
async def reader(border: BorderSite, name: str = "/heating") -> AsyncIterator[Node]:
    """A node that may read what the lamp publishes."""
    border.site.subscribe(name, f"{LAMP}/temperature")
    async with border.site.node(name) as node:
        yield node


def with_values(thing: Thing | SecretThing) -> tuple[Value, Value, Value]:
    """The resources of the lamp: temperature, light, switch."""
    made = [thing.add(path, Value(60)) for path in ("/t", "/l", "/s")]
    made[0].state = encode({"data": 20.5})
    return made[0], made[1], made[2]


def allow_all(border: BorderSite) -> None:
    border.allow()
    border.allow(right=Right.SUBSCRIBE)
    border.allow(right=Right.PROVIDE)


@pytest.mark.parametrize("kind", ["key", "secret"])
async def test_a_thing_publishes_subscribes_and_provides(border: BorderSite, kind: str) -> None:
    allow_all(border)
    thing = border.thing() if kind == "key" else border.secret_thing()
    temperature, light, switch = with_values(thing)
    switch.handler = lambda body: encode({"success": body == encode({"data": True}), "message": "on"})
    border.site.publish("/heating", f"{LAMP}/light")
    border.site.grant("/heating", Right.CALL, f"{LAMP}/switch")
    async with reader(border) as node, thing:
        assert (await thing.register()).dotted == "2.04"
        seen = await node.subscriber(f"{LAMP}/temperature", "std_msgs/Float32")
        await until(lambda: seen.links)
        temperature.set(encode({"data": 21.5}))
        async with asyncio.timeout(DEADLINE):
            assert (await anext(aiter(seen))).data == 21.5
            lamp = await node.publisher(f"{LAMP}/light", "std_msgs/Bool")
            await lamp.wait_for_subscribers()
            lamp.publish(lamp.create(data=True))
            await light.arrived.wait()
            assert decode(light.written[0]) == {"data": True}
            call = node.client(f"{LAMP}/switch", "std_srvs/SetBool")
            answer = await call(data=True)
        assert (answer.success, answer.message) == (True, "on")


async def test_a_revoked_thing_ends_within_a_second(border: BorderSite) -> None:
    border.allow()
    thing = border.thing()
    with_values(thing)
    statement = border.roster_statement(LAMP)
    async with reader(border) as node, thing:
        await thing.register()
        seen = await node.subscriber(f"{LAMP}/temperature", "std_msgs/Float32")
        await until(lambda: seen.links)
        await border.revoke(statement.id)
        await until(lambda: not seen.links)
        assert LAMP not in border.router.bridges
        thing.forget()
        assert await refused(thing)


async def test_a_thing_that_restarts_is_served_again(border: BorderSite) -> None:
    border.allow()
    thing = border.thing()
    temperature, *_ = with_values(thing)
    async with reader(border) as node:
        async with thing:
            await thing.register()
            seen = await node.subscriber(f"{LAMP}/temperature", "std_msgs/Float32")
            await until(lambda: seen.links)
        thing.forget()
        async with thing:
            before = border.router.bridges[LAMP].received
            await thing.register()
            assert border.router.server.endpoint.counts.handshakes == 2
            await until(lambda: border.router.bridges[LAMP].received > before)
            temperature.set(encode({"data": 1.5}))
            async with asyncio.timeout(DEADLINE):
                while (await anext(aiter(seen))).data != 1.5:
                    pass


@pytest.mark.parametrize("kind", ["key", "secret"])
async def test_a_router_that_restarts_serves_its_things_again(site: Site, kind: str) -> None:
    border = BorderSite(site)
    async with border.running():
        border.allow()
        thing = border.thing() if kind == "key" else border.secret_thing()
        with_values(thing)
        port = border.address[1]
        await thing.start()
        assert (await thing.register()).dotted == "2.04"
    async with border.running(port):
        with contextlib.suppress(Exception):  # it learns that its context is gone
            await thing.register()
        thing.forget()
        assert (await thing.register()).dotted == "2.04"
        await until(lambda: LAMP in border.router.bridges)
        await until(lambda: border.router.bridges[LAMP].received)
    await thing.close()


async def test_a_thing_of_another_router_is_not_served(border: BorderSite, site: Site) -> None:
    other = BorderSite(site, "/attic")
    async with other.running():
        thing = border.thing()
        assert isinstance(thing.credential, ThingKey)
        async with thing:
            await thing.register()
            thing.forget()
            thing.border = other.address
            thing.peer = other.key.credential
            assert await refused(thing)
        assert not other.router.bridges
