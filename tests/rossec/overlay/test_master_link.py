"""A relay and its master: forwarded ports are opened and told, and targets asked for, over real calls."""

import asyncio
from collections.abc import AsyncIterator, Mapping
from contextlib import AsyncExitStack
from typing import Any, cast

import pytest

from ca.certificates import Identity
from rossec.errors import RelayRefused, StreamRefused
from rossec.host.runner import TaskSet
from rossec.master.state.forwarded_ports import ForwardedPort, PeerWay, Target
from rossec.master.state.registry import NodeRef
from rossec.net.aio import SecureStream, WireProtocol, connect
from rossec.net.rpc import calls as rpc_client
from rossec.overlay import masters
from rossec.overlay.masters import MasterLink
from rossec.ros.xmlrpc import Fault
from tests.rossec.master.world import World, until
from tests.support.contexts import unlimited

ROBOT, CLOCK = Target("office", "node", "/robot"), Target("office", "service", "/clock")


class Table:
    """Forwarded ports on ports that nobody listens at."""

    def __init__(self) -> None:
        self.open_for: dict[Target, str] = {}
        self.refused: set[Target] = set()
        self.dropped: set[Target] = set()
        self.base = 7000

    async def open(self, target: Target, master: str) -> ForwardedPort:
        if target in self.refused:
            raise RelayRefused("no such peer", "rossec relay add")
        self.open_for[target] = master
        return ForwardedPort("127.0.0.1", self.base + len(target.name))

    def release(self, target: Target, master: str) -> None:
        assert self.open_for.pop(target) == master

    def take_dropped(self, master: str) -> set[Target]:
        dropped, self.dropped = self.dropped, set()
        return dropped

    def ways(self) -> Mapping[str, PeerWay]:
        return {"office": PeerWay("up", 12.5, 3, "tls/r:7447", 2)}


class Relay:
    """A relay of a master."""

    def __init__(self, world: World, name: str = "/master") -> None:
        self.world, self.table = world, Table()
        self.masters: Mapping[str, str] = {}
        self.member = world.site.enroll("/relay")
        self.dialled = 0
        self.streams: list[SecureStream[Identity]] = []
        self.link = MasterLink(name, "/relay", "one", self.dial, cast("Any", self.table), self._take)

    async def dial(self) -> SecureStream[Identity]:
        self.dialled += 1
        context = unlimited(self.member.credentials, self.world.site.anchor.verify)
        port = self.world.server.port
        stream = await connect("127.0.0.1", port, context, WireProtocol.HTTP)
        self.streams.append(stream)
        return stream

    def _take(self, masters: Mapping[str, str]) -> None:
        self.masters = masters


@pytest.fixture
async def world() -> AsyncIterator[World]:
    async with AsyncExitStack() as stack:
        found = World(stack)
        await found.start()
        yield found


@pytest.fixture
async def tasks() -> AsyncIterator[TaskSet]:
    found = TaskSet()
    yield found
    await found.close()


@pytest.fixture
async def relay(world: World) -> AsyncIterator[Relay]:
    found = Relay(world)
    yield found
    await found.link.close()


async def test_forwarded_ports_are_opened_told_and_released(relay: Relay, tasks: TaskSet) -> None:
    forwarded_ports = relay.world.server.state.forwarded_ports
    forwarded_ports.masters = lambda: {"/master/kitchen": "http://kitchen:11311/"}
    running = tasks.spawn(relay.link.run(), "link")
    forwarded_ports.want("office", [ROBOT])
    await until(lambda: forwarded_ports.forwarded_port(ROBOT) == ForwardedPort("127.0.0.1", 7006))
    forwarded_ports.want("office", [ROBOT, CLOCK])
    await until(lambda: forwarded_ports.forwarded_port(CLOCK) is not None)
    assert relay.table.open_for == {ROBOT: "/master", CLOCK: "/master"}
    assert forwarded_ports.way("office") == ("/relay", PeerWay("up", 12.5, 3, "tls/r:7447", 2))
    assert relay.masters == {"/master/kitchen": "http://kitchen:11311/"}
    forwarded_ports.want("office", [CLOCK])
    await until(lambda: relay.table.open_for == {CLOCK: "/master"})
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)
    assert relay.table.open_for == {}
    assert relay.link.error == ""


async def test_what_cannot_be_opened_is_tried_again(
    relay: Relay, tasks: TaskSet, caplog: pytest.LogCaptureFixture
) -> None:
    forwarded_ports = relay.world.server.state.forwarded_ports
    relay.table.refused = {ROBOT}
    tasks.spawn(relay.link.run(), "link")
    forwarded_ports.want("office", [ROBOT])
    await until(lambda: "no forwarded port for /robot of office: no such peer" in caplog.text)
    relay.table.refused = set()
    forwarded_ports.want("office", [ROBOT, CLOCK])
    await until(lambda: forwarded_ports.forwarded_port(ROBOT) is not None)


async def test_a_forwarded_port_of_a_peer_that_was_removed_and_is_back_is_opened_again(
    relay: Relay, tasks: TaskSet
) -> None:
    forwarded_ports = relay.world.server.state.forwarded_ports
    tasks.spawn(relay.link.run(), "link")
    forwarded_ports.want("office", [ROBOT])
    await until(lambda: forwarded_ports.forwarded_port(ROBOT) is not None)
    relay.table.base, relay.table.dropped = 8000, {ROBOT}
    forwarded_ports.want("office", [ROBOT, CLOCK])
    await until(lambda: forwarded_ports.forwarded_port(ROBOT) == ForwardedPort("127.0.0.1", 8006))


async def test_the_connection_is_made_again_and_forwarded_ports_are_told_anew(
    relay: Relay, tasks: TaskSet
) -> None:
    forwarded_ports = relay.world.server.state.forwarded_ports
    tasks.spawn(relay.link.run(), "link")
    forwarded_ports.want("office", [ROBOT])
    await until(lambda: forwarded_ports.forwarded_port(ROBOT) is not None)
    forwarded_ports.expire(relay.world.server.state.now() + 100)
    assert forwarded_ports.forwarded_port(ROBOT) is None
    relay.streams[0].abort("the line is cut")
    await until(lambda: forwarded_ports.forwarded_port(ROBOT) is not None)
    assert relay.dialled == 2


async def test_another_master_than_expected_is_not_polled(
    world: World, tasks: TaskSet, caplog: pytest.LogCaptureFixture
) -> None:
    relay = Relay(world, "/master/kitchen")
    tasks.spawn(relay.link.run(), "link")
    await until(lambda: "/master answers at the address of /master/kitchen" in relay.link.error)
    with pytest.raises(RelayRefused):
        await relay.link.target("", "master", "/master")
    assert caplog.text.count("answers at the address") == 1


async def test_targets_are_asked_for(relay: Relay) -> None:
    world, link = relay.world, relay.link
    node = NodeRef("/arm", "http://10.0.0.3:4711/", b"arm")
    world.server.state.registry.register_publisher("/pose", "std_msgs/String", node)
    assert await link.target("", "node", "/arm") == ("10.0.0.3", 4711)
    assert await link.target("", "master", "/master") == ("127.0.0.1", world.server.port)
    with pytest.raises(StreamRefused, match="/master: rossec: no node /leg is shown there"):
        await link.target("", "node", "/leg")
    assert relay.dialled == 1


async def test_targets_are_asked_for_on_a_new_connection_when_the_old_one_has_ended(relay: Relay) -> None:
    found = await relay.link.target("", "master", "/master")
    await next(iter(relay.world.server.state.streams)).close()
    assert await relay.link.target("", "master", "/master") == found


async def test_a_master_that_knows_no_relays_is_reported(
    relay: Relay, tasks: TaskSet, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    async def unknown(_self: object, method: str, *_: object) -> object:
        raise Fault(1, f'method "{method}" is not supported')

    monkeypatch.setattr(rpc_client.RpcClient, "ask", unknown)
    monkeypatch.setattr(masters, "OLD_MASTER", 0.01)
    tasks.spawn(relay.link.run(), "link")
    await until(lambda: "it is older than this relay, update it" in relay.link.error)
    await until(lambda: relay.dialled > 1)
    assert caplog.text.count("it is older") == 1
    with pytest.raises(StreamRefused, match="not supported"):
        await relay.link.target("", "master", "/master")
