"""A node that may connect to itself is redirected to itself: by network, master or publisher.

Whatever redirects a connection that is meant for another node, it never ends at the node itself.
"""

import asyncio
import contextlib
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from ca.certificates import Identity
from ca.errors import HintedError
from grants.model import Right
from rossec.channel.opening import WireProtocol
from rossec.errors import ChannelClosed, IdentityRefused
from rossec.net.aio import SecureStream, serve
from rossec.net.rpc.calls import serve_calls
from rossec.node import Node, Subscriber
from rossec.participant.slave_api import NO_TRANSPORT
from rossec.ros.names import parse_uri
from rossec.sidecar.core.layers import local_endpoint
from tests.rossec.sidecar.program import Program, sidecar
from tests.support.attacker import EVE, HOST, call, credentials
from tests.support.contexts import unlimited
from tests.support.fleet import SECURE, entitle, environment, program
from tests.support.site import Site
from tests.support.witness import until

pytestmark = pytest.mark.attack("own-reflection")
NAME, TOPIC, STRING = "/robot", "/loop", "std_msgs/String"
OWN = "the peer sent this node's own certificate"


@contextlib.asynccontextmanager
async def redirecting(port: int) -> AsyncIterator[int]:
    """A port whose connections end at `port`, byte for byte: an attacker on the path."""
    open_ones: set[asyncio.StreamWriter] = set()

    async def carry(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(OSError):
            while data := await reader.read(65536):
                writer.write(data)
                await writer.drain()
            writer.write_eof()

    async def accept(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        onward, back = await asyncio.open_connection(HOST, port)
        open_ones.update((writer, back))
        await asyncio.gather(carry(reader, back), carry(onward, writer))
        for each in (writer, back):
            each.close()

    server = await asyncio.start_server(accept, HOST, 0)
    try:
        yield int(server.sockets[0].getsockname()[1])
    finally:
        server.close()
        for writer in open_ones:
            writer.close()


@pytest.fixture
async def robot(site: Site) -> AsyncIterator[Node]:
    """It publishes what it subscribes to, so that it could receive from itself."""
    site.publish(NAME, TOPIC)
    site.subscribe(NAME, TOPIC)
    async with site.node(NAME) as robot:
        await robot.publisher(TOPIC, STRING)
        yield robot


async def refused(heard: Subscriber, uri: str) -> HintedError:
    """Why the subscriber refuses the publisher at `uri`."""
    await until(lambda: heard.links)
    before = set(heard.links)  # itself, where it meant to
    heard.refusals.clear()
    heard.update([uri])
    await until(lambda: heard.refusals)
    assert not heard.links - before
    return heard.refusals[0]


async def test_a_dial_for_another_publisher_is_redirected(robot: Node) -> None:
    heard = await robot.subscriber(TOPIC, STRING)
    async with redirecting(parse_uri(robot.uri)[1]) as port:
        error = await refused(heard, f"http://{HOST}:{port}/")
    assert str(error) == OWN


async def test_a_call_of_another_provider_is_redirected(site: Site, robot: Node) -> None:
    for right in (Right.PROVIDE, Right.CALL):
        site.grant(NAME, right, "/echo")
    async with redirecting(robot.topic_endpoint()[1]) as port:
        with pytest.raises(IdentityRefused, match=OWN):
            await robot._dialer.service(f"rosrpc://{HOST}:{port}")
    stream = await robot._dialer.service(f"rosrpc://{HOST}:{robot.topic_endpoint()[1]}")
    assert stream.peer.name == NAME
    stream.abort("where it meant to")


@contextlib.asynccontextmanager
async def publisher_that_points(site: Site, port: int) -> AsyncIterator[str]:
    """A node that may publish, and gives the robot's own port for its topic."""
    site.publish(EVE, TOPIC)

    async def answer(method: str, params: tuple[object, ...], _: Identity) -> object:
        return [1, "ready", ["TCPROS", HOST, port]]

    async def api(stream: SecureStream[Identity]) -> None:
        await serve_calls(stream, answer)

    verify = site.anchor.verify
    async with serve(api, HOST, 0, unlimited(credentials(site), verify), WireProtocol.HTTP) as server:
        yield f"http://{HOST}:{server.port}/"


async def test_an_authorized_publisher_names_the_nodes_own_port(site: Site, robot: Node) -> None:
    heard = await robot.subscriber(TOPIC, STRING)
    async with publisher_that_points(site, robot.topic_endpoint()[1]) as uri:
        error = await refused(heard, uri)
    assert str(error).endswith("sends this node to itself")


async def test_an_authorized_publisher_names_a_redirecting_port(site: Site, robot: Node) -> None:
    heard = await robot.subscriber(TOPIC, STRING)
    async with redirecting(robot.topic_endpoint()[1]) as port, publisher_that_points(site, port) as uri:
        assert str(await refused(heard, uri)) == OWN


async def register_redirect(site: Site, port: int) -> None:
    """Eve may publish as well; the address she registers is the victim's."""
    assert site.master is not None
    site.publish(EVE, TOPIC)
    uri, own = site.master.uri, credentials(site)
    await call(uri, own, "rossec.presentGrants", EVE, site.enroll(EVE).grants())
    answer = await call(uri, own, "registerPublisher", EVE, TOPIC, STRING, f"http://{HOST}:{port}/")
    assert isinstance(answer, list)
    assert answer[0] == 1, answer


async def test_a_program_behind_a_sidecar(site: Site) -> None:
    site.publish(NAME, TOPIC)
    site.subscribe(NAME, TOPIC)
    async with sidecar(site) as near, Program(NAME, near) as robot:
        await robot.register("registerPublisher", TOPIC, STRING)
        outside = near._agent_for(NAME).state.endpoints
        (port,) = [place.port for place in outside._ingress]
        async with redirecting(port) as redirect:
            await register_redirect(site, redirect)
            uris = await robot.register("registerSubscriber", TOPIC, STRING)
            assert isinstance(uris, list)
            assert robot.uri in uris
            (eve,) = set(uris) - {robot.uri}
            with pytest.raises(ChannelClosed):
                await robot.ask(eve, "requestTopic", TOPIC, [["TCPROS"]])
        assert all(method != "requestTopic" for method, _ in robot.calls)


async def test_a_program_behind_a_sidecar_gets_its_own_port(site: Site) -> None:
    site.publish(NAME, TOPIC)
    site.subscribe(NAME, TOPIC)
    async with sidecar(site) as near, Program(NAME, near) as robot:
        await robot.register("registerPublisher", TOPIC, STRING)
        agent = near._agent_for(NAME)
        topics = local_endpoint(WireProtocol.TCPROS, robot.topics.port)
        port = agent.open_ingress(topics)  # as a subscriber of its topic gets it
        agent.state.endpoints.add_ingress(topics, port)
        async with publisher_that_points(site, port) as uri:
            await register_redirect(site, parse_uri(uri)[1])
            uris = await robot.register("registerSubscriber", TOPIC, STRING)
            assert isinstance(uris, list)
            (eve,) = set(uris) - {robot.uri}
            answer = await robot.ask(eve, "requestTopic", TOPIC, [["TCPROS"]])
        assert answer == [-1, NO_TRANSPORT, []]


HEARS = (
    SECURE
    + """
import rospy
from std_msgs.msg import String
rospy.init_node("robot")
def print_whole(message):  # in one write: other threads print as well
    print(f"HEARD {message.data}\\n", end="", flush=True)
said = rospy.Publisher("/loop", String, queue_size=10)
heard = rospy.Subscriber("/loop", String, print_whole)
print("AT", rospy.get_node_uri(), flush=True)
input()
while said.get_num_connections() < 1:
    rospy.rostime.wallsleep(0.05)
for number in range(5):
    said.publish(str(number))
    rospy.rostime.wallsleep(0.1)
print("LINKS", said.get_num_connections(), heard.get_num_connections(), flush=True)
rospy.spin()
"""
)


@pytest.mark.ros
async def test_a_rospy_program(site: Site, tmp_path: Path) -> None:
    entitle(site, NAME, {Right.PUBLISH: (TOPIC,), Right.SUBSCRIBE: (TOPIC,)})
    async with program(environment(site, tmp_path / "logs"), HEARS, told=True) as robot:
        uri = (await robot.read_until("AT ")).split()[1]
        async with redirecting(parse_uri(uri)[1]) as port:
            await register_redirect(site, port)
            await robot.read_until(OWN)
            await robot.tell("go on")
            await robot.read_until("LINKS 1 ")
    assert [robot.said.count(f"HEARD {number}") for number in range(5)] == [1] * 5
