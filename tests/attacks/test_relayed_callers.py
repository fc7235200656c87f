"""Who comes by a relay of this host comes from loopback, and is not near: attack M8."""

import asyncio
import contextlib
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack

import pytest

from ca.certificates import Identity
from rossec.host.addresses import source_for
from rossec.master.state.forwarded_ports import ForwardedPort, PeerWay, RelayReport, Target
from rossec.net.aio import SecureStream, WireProtocol, connect
from rossec.net.rpc.calls import RpcClient
from rossec.ros.names import parse_uri
from tests.rossec.master.visiting import VisitWorld
from tests.rossec.master.world import EVERYTHING, T, until
from tests.support.authority import EnrolledNode
from tests.support.contexts import unlimited
from tests.support.relaying import brought_by

RELAY, ALIAS = "/remote/hospital/relay", "/remote/hospital/rounds/robot3"
NEAR, FAR = "http://127.0.0.1:4711/", "http://10.0.0.9:1/"
WAY = {"state": "up", "rtt_ms": 1.0, "retransmissions": 0, "router": "", "streams": 0}


@pytest.fixture
async def world() -> AsyncIterator[VisitWorld]:
    async with AsyncExitStack() as stack:
        found = VisitWorld(stack)
        await found.start()
        yield found


@contextlib.asynccontextmanager
async def caller(world: VisitWorld, member: EnrolledNode, *, relay: str = RELAY) -> AsyncIterator[RpcClient]:
    """A connection by a relay on the master's host; without a `relay` a straight one."""
    async with AsyncExitStack() as stack:
        port = parse_uri(world.server.uri)[1]
        if relay:
            port = await stack.enter_async_context(brought_by(relay, port))
        context = unlimited(member.credentials, world.site.anchor.verify)
        stream: SecureStream[Identity] = await connect("127.0.0.1", port, context, WireProtocol.HTTP)
        stack.push_async_callback(stream.close)
        client = RpcClient(stream)
        if member.name != "/relay":
            grant = world.site.grant(member, EVERYTHING)
            await client.ask("rossec.presentGrants", member.name, [grant])
        yield client


@pytest.mark.attack("near-by-relay")
@pytest.mark.parametrize(
    "uri", [NEAR, "http://localhost:4711/", "http://[::1]:4711/", "http://127.82.0.9:4711/"]
)
async def test_m8_a_foreigner_behind_a_relay_on_the_masters_host_registers_no_loopback_address(
    world: VisitWorld, uri: str
) -> None:
    name = world.robot.name
    async with caller(world, world.robot) as client:
        for method, *params in (
            ("registerPublisher", "/pose", T, uri),
            ("registerSubscriber", "/pose", T, uri),
            ("registerService", "/s", "rosrpc://10.0.0.9:2", uri),
            ("registerService", "/s", uri.replace("http", "rosrpc"), "http://10.0.0.9:1/"),
            ("subscribeParam", uri, "/p"),
        ):
            found = await client.call(method, name, *params)
            assert isinstance(found, list)
            assert found[0] == -1, method
    assert not tuple(world.server.state.registry.nodes())


@pytest.mark.attack("near-by-relay")
async def test_m8_a_node_of_the_own_domain_at_another_place_registers_none_either(world: VisitWorld) -> None:
    member = world.site.enroll("/robot")
    async with caller(world, member, relay="/relay/office") as client:
        found = await client.call("registerPublisher", "/robot", "/pose", T, NEAR)
        assert isinstance(found, list)
        assert found[0] == -1
        assert "set ROS_IP or ROS_HOSTNAME" in str(found[1])
        assert await client.ask("registerPublisher", "/robot", "/pose", T, "http://10.0.0.9:1/") == []
    assert [each.uri for each in world.server.state.registry.nodes()] == ["http://10.0.0.9:1/"]


@pytest.mark.attack("near-by-relay")
async def test_m8_the_same_calls_of_who_is_near_are_answered(world: VisitWorld) -> None:
    async with caller(world, world.robot, relay="") as client:
        assert await client.ask("registerPublisher", world.robot.name, "/pose", T, NEAR) == []
    assert [each.name for each in world.server.state.registry.nodes()] == [ALIAS]


@pytest.mark.attack("near-by-relay")
async def test_m8_a_forwarded_port_is_registered_by_nobody(world: VisitWorld) -> None:
    forwarded_ports, target = world.server.state.forwarded_ports, Target("ward", "node", "/bed")
    forwarded_ports.want("ward", [target])
    report = RelayReport(
        "one", 0, {target: ForwardedPort("10.0.0.7", 7001)}, {"ward": PeerWay("up", 1.0, 0, "", 0)}
    )
    forwarded_ports.hear("/relay", report, world.server.state.now())
    async with caller(world, world.robot) as client:
        found = await client.call("registerPublisher", world.robot.name, "/pose", T, "http://10.0.0.7:7001/")
        assert isinstance(found, list)
        assert "a relay of this site listens at this address" in str(found[1])
    assert not tuple(world.server.state.registry.nodes())


@pytest.mark.attack("near-by-relay")
async def test_m8_a_relay_that_comes_by_a_relay_has_no_forwarded_ports_and_no_targets_on_this_host(
    world: VisitWorld,
) -> None:
    relay, robot = world.site.enroll("/relay"), world.site.enroll("/robot")
    async with caller(world, robot, relay="") as client:
        await client.ask("registerPublisher", "/robot", "/pose", T, NEAR)
    forwarded_port = ["ward", "node", "/bed", "127.0.0.1", 22]
    world.server.state.forwarded_ports.want("ward", [Target("ward", "node", "/bed")])  # answered at once
    for by, code in ((RELAY, -1), ("", 1)):
        async with caller(world, relay, relay=by) as client:
            target = await client.call("rossec.relayTarget", "/relay", "", "node", "/robot")
            forwarded_ports = await client.call(
                "rossec.relayForwardedPorts", "/relay", "one", 0, [forwarded_port], {"ward": WAY}
            )
            assert isinstance(target, list)
            assert isinstance(forwarded_ports, list)
            assert (target[0], forwarded_ports[0]) == (code, code)


@pytest.mark.attack("near-by-relay")
async def test_n8_half_open_connections_of_one_remote_relay_leave_those_of_another_alone(
    world: VisitWorld,
) -> None:
    """The caps for one address hold for each remote relay, which has an address of its own."""
    port, count = parse_uri(world.server.uri)[1], world.server.context.half_open
    held: list[asyncio.StreamWriter] = []
    assert count is not None
    try:
        for _ in range(200):
            source = (source_for(RELAY), 0)
            _, writer = await asyncio.open_connection("127.0.0.1", port, local_addr=source)
            held.append(writer)
        await until(lambda: len(count) >= 128)
        async with caller(world, world.robot, relay="/remote/ward/relay") as client:
            assert await client.ask("getPid", world.robot.name)
        assert len(count) <= 128
    finally:
        for writer in held:
            writer.transport.abort()
