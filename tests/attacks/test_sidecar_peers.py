"""Enrolled peers that lie to a sidecar: in headers, in answers. Real sockets on both sides."""

import contextlib
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from ca.certificates import Identity
from ca.encoding import Value, encode
from ca.revocation.lists import Timestamp, digest, sign_timestamp
from grants.model import Right
from rossec.channel.opening import WireProtocol
from rossec.errors import ChannelClosed, ChannelError
from rossec.net.aio import SecureServer, SecureStream, connect, serve
from rossec.net.aio.client import dial
from rossec.net.rpc.calls import CallFailed, RpcClient, serve_calls
from rossec.participant.access import FIELD
from rossec.ros import tcpros, xmlrpc
from rossec.ros.names import parse_uri
from rossec.ros.xmlrpc import Encoded
from rossec.sidecar.loopback_port import PlainStream
from rossec.sidecar.pump import split_header
from rossec.sidecar.server import Sidecar
from tests.rossec.sidecar.program import Program, sidecar
from tests.support.attacker import expect_no_room
from tests.support.contexts import unlimited
from tests.support.site import Site
from tests.support.witness import until

PLAIN = ["TCPROS", "127.0.0.1", 9]
"""Where the peer would like to be met without the channel."""


@pytest.fixture
async def site(tmp_path: Path) -> AsyncIterator[Site]:
    site = Site(tmp_path / "site")
    site.publish("/robot", "/word")
    site.subscribe("/robot", "/lies")
    site.publish("/mallory", "/lies")
    site.grant("/mallory", Right.CALL, "/anything")
    async with site.running() as site:
        yield site


@pytest.fixture
async def near(site: Site) -> AsyncIterator[Sidecar]:
    async with sidecar(site) as near:
        yield near


async def connect_as_mallory(site: Site, port: int, protocol: WireProtocol) -> SecureStream[Identity]:
    """Connect as /mallory to a port of the sidecar."""
    credentials = site.enroll("/mallory").credentials()
    return await connect("127.0.0.1", port, unlimited(credentials, site.anchor.verify), protocol)


def port_of(near: Sidecar) -> SecureServer[Identity]:
    """The port of the slave API of /robot on the network."""
    return next(iter(near._agent_for("/robot")._ingress.ports))


@pytest.mark.attack("two-readings")
async def test_a_right_to_call_gives_no_topic(site: Site, near: Sidecar) -> None:
    """One header with a service for the sidecar and a topic for the program behind it."""
    async with Program("/robot", near) as robot:
        await robot.register("registerPublisher", "/word", "std_msgs/String")
        client = RpcClient(await connect_as_mallory(site, port_of(near).port, WireProtocol.HTTP))
        answer = await client.call("requestTopic", "/mallory", "/word", [["TCPROS"]])
        assert isinstance(answer, list)
        grants: list[Value] = [*site.enroll("/mallory").grants()]
        fields = {
            "callerid": b"/mallory",
            "type": b"*",
            "md5sum": b"*",
            "topic": b"/word",
            "service": b"/anything",
            FIELD: encode(grants),
        }
        stream = await connect_as_mallory(site, answer[2][2], WireProtocol.TCPROS)
        await stream.send(tcpros.encode(fields))
        said, _ = await split_header(stream)
        assert b"for a topic or for a service" in said["error"]
        assert robot.headers == []
        stream.abort("done")
        await client.close()


@contextlib.asynccontextmanager
async def false_publisher(site: Site, answer: object) -> AsyncIterator[str]:
    """A publisher of /lies, registered with the master, whose slave API says `answer`."""
    home = site.enroll("/mallory")

    async def handler(stream: SecureStream[Identity]) -> None:
        await serve_calls(stream, lambda *_: answer)

    server = serve(
        handler, "127.0.0.1", 0, unlimited(home.credentials(), site.anchor.verify), WireProtocol.HTTP
    )
    assert site.master is not None
    port = int(site.master.uri.rstrip("/").rpartition(":")[2])
    client = RpcClient(await connect_as_mallory(site, port, WireProtocol.HTTP))
    await client.ask("rossec.presentGrants", "/mallory", home.grants())
    uri = f"http://127.0.0.1:{server.port}/"
    await client.ask("registerPublisher", "/mallory", "/lies", "std_msgs/String", uri)
    try:
        yield uri
    finally:
        await client.close()
        await server.close()


UNSEEN = xmlrpc.dump_response([1, "", PLAIN]).replace(b"</methodResponse>", b"</methodResponse><")


@pytest.mark.attack("address-outside")
@pytest.mark.parametrize("answer", [[2, "", PLAIN], [True, "", PLAIN], Encoded(UNSEEN)])
async def test_addresses_outside_the_channel_are_refused(site: Site, near: Sidecar, answer: object) -> None:
    """rospy treats any positive code as success; lenient parsers accept what ours refuses."""
    async with false_publisher(site, answer), Program("/robot", near) as robot:
        uris = await robot.register("registerSubscriber", "/lies", "std_msgs/String")
        assert isinstance(uris, list)
        program = RpcClient(PlainStream(await dial(*parse_uri(str(uris[0])), 10)))
        heard = b""
        with contextlib.suppress(CallFailed, ChannelClosed):
            heard = await program.fetch("requestTopic", "/robot", "/lies", [["TCPROS"]])
        assert b"TCPROS" not in heard
        await program.close()


@pytest.mark.attack("steered-program")
async def test_only_the_master_sends_revocation_updates(site: Site, near: Sidecar) -> None:
    """The list is signed by the authority, but only the master may confirm it as the newest."""
    async with Program("/robot", near) as robot:
        await robot.register("registerPublisher", "/word", "std_msgs/String")
        agent = near._agent_for("/robot")
        held = agent._membership._identity.revocations.current
        assert held is not None
        until_then = agent._membership._identity.revocations.fresh_until
        signer = site.enroll("/mallory").credentials().signer
        stamp = Timestamp(held.seq, digest(agent._membership._identity.revocations.data), site.now() + 4, 30)
        client = RpcClient(await connect_as_mallory(site, port_of(near).port, WireProtocol.HTTP))
        answer = await client.call("rossec.revocationUpdate", "/master", b"", sign_timestamp(signer, stamp))
        assert "for the master alone" in str(answer)
        assert agent._membership._identity.revocations.fresh_until < site.now() + 34
        assert agent._membership._identity.revocations.fresh_until >= until_then
        await client.close()


@pytest.mark.attack("sidecar-exhausted")
async def test_a_subscriber_that_sends_data_gets_nothing(site: Site, near: Sidecar) -> None:
    """With its header or after it."""
    site.subscribe("/mallory", "/word")
    grants: list[Value] = [*site.enroll("/mallory").grants()]
    asked = {"callerid": b"/mallory", "type": b"*", "md5sum": b"*", "topic": b"/word", FIELD: encode(grants)}
    async with Program("/robot", near) as robot:
        await robot.register("registerPublisher", "/word", "std_msgs/String")
        client = RpcClient(await connect_as_mallory(site, port_of(near).port, WireProtocol.HTTP))
        answer = await client.call("requestTopic", "/mallory", "/word", [["TCPROS"]])
        assert isinstance(answer, list)
        for units in ([tcpros.encode(asked) + b"data"], [tcpros.encode(asked), b"data"]):
            stream = await connect_as_mallory(site, answer[2][2], WireProtocol.TCPROS)
            for unit in units:
                await stream.send(unit)
            said, _ = await split_header(stream)
            assert "error" not in said
            with pytest.raises(ChannelError):
                await stream.receive()
        await client.close()


@pytest.mark.attack("outlived-right")
async def test_a_revoked_peer_is_not_called_over_an_old_connection(site: Site, near: Sidecar) -> None:
    async with false_publisher(site, [1, "", 4711]) as uri, Program("/robot", near) as robot:
        uris = await robot.register("registerSubscriber", "/lies", "std_msgs/String")
        assert isinstance(uris, list)
        program = RpcClient(PlainStream(await dial(*parse_uri(str(uris[0])), 10)))
        assert await program.call("getPid", "/robot") == [1, "", 4711]
        agent = near._agent_for("/robot")
        data = site.revoke(site.identity("/mallory").thumbprint)
        await agent._membership.session.call("rossec.updateRevocations", data)
        await until(lambda: agent._membership._identity.revocations.data == data)
        with pytest.raises((CallFailed, ChannelClosed)):
            await program.call("getPid", "/robot")
        assert uri
        await program.close()


@pytest.mark.attack("unit-before-right")
async def test_units_before_authorization_are_limited_to_a_call(site: Site, near: Sidecar) -> None:
    """A unit is buffered before it is checked."""
    async with Program("/robot", near) as robot:
        await robot.register("registerPublisher", "/word", "std_msgs/String")
        port = port_of(near).port
        client = RpcClient(await connect_as_mallory(site, port, WireProtocol.HTTP))
        offered = await client.ask("requestTopic", "/mallory", "/word", [["TCPROS"]])
        assert isinstance(offered, list)
        await expect_no_room(await connect_as_mallory(site, offered[2], WireProtocol.TCPROS), 300_000)
        await client.close()
        await expect_no_room(await connect_as_mallory(site, port, WireProtocol.HTTP), 3 * 1024 * 1024)
