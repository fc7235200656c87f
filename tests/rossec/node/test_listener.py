"""The two ports of a node, with a peer that violates the protocol."""

import asyncio
import contextlib
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from ca.certificates import Identity
from ca.encoding import encode
from grants.model import Right
from rossec.errors import ChannelError, PlainPeer
from rossec.net.aio import SecureStream, WireProtocol, connect
from rossec.net.rpc.calls import RpcClient
from rossec.node import Node, node
from rossec.participant import connections, slave_api
from rossec.participant.slave_api import SLAVE_CALLS
from rossec.ros import tcpros
from rossec.ros.names import parse_uri
from tests.support.attacker import fields_for
from tests.support.contexts import unlimited
from tests.support.site import Site

POSE = "geometry_msgs/PoseStamped"


@pytest.fixture
async def site(tmp_path: Path) -> AsyncIterator[Site]:
    async with Site(tmp_path / "site").running() as site:
        site.publish("/robot", "/robot/pose")
        yield site


@pytest.fixture
async def robot(site: Site) -> AsyncIterator[Node]:
    async with site.node("/robot") as robot:
        await robot.publisher("/robot/pose", POSE)
        yield robot


async def request(site: Site, robot: Node, *pieces: bytes) -> dict[str, bytes]:
    """The answer of the topic port to `/viewer` sending `pieces`, one unit each."""
    credentials = site.enroll("/viewer").credentials()
    _, port = robot.topic_endpoint()
    stream = await connect("127.0.0.1", port, unlimited(credentials, site.anchor.verify))
    for piece in pieces:
        await stream.send(piece)
    reader = tcpros.FrameReader()
    while not (frames := reader.feed(await stream.receive())):
        pass
    await ended(stream)
    return tcpros.decode(frames[0])


async def ended(stream: SecureStream[Identity]) -> None:
    async with asyncio.timeout(30):
        with contextlib.suppress(ChannelError):
            while True:
                await stream.receive()


def subscriber_header(**fields: str) -> bytes:
    return tcpros.encode(
        {"callerid": "/viewer", "topic": "/robot/pose", "md5sum": "*", "type": "*", **fields}
    )


async def test_a_subscriber_without_a_grant_receives_an_error_only(site: Site, robot: Node) -> None:
    answer = await request(site, robot, subscriber_header())
    assert answer == {"error": b"rossec: /viewer shows no grant to subscribe /robot/pose"}


async def test_the_answer_does_not_reveal_whether_a_topic_exists(site: Site, robot: Node) -> None:
    there = await request(site, robot, subscriber_header())
    not_there = await request(site, robot, subscriber_header(topic="/robot/none"))
    assert there["error"].replace(b"/robot/pose", b"/robot/none") == not_there["error"]


async def test_a_false_callerid_is_refused(site: Site, robot: Node) -> None:
    answer = await request(site, robot, subscriber_header(callerid="/robot"))
    assert b"a node certified as /viewer calls itself /robot" in answer["error"]


async def test_an_authorized_subscriber_is_told_that_a_topic_is_not_published(
    site: Site, robot: Node
) -> None:
    site.subscribe("/viewer", "/robot/none")
    (grant,) = site.enroll("/viewer").grants()
    fields = {"rossec_grants": (b"\x81\x59" + len(grant).to_bytes(2) + grant)}
    answer = await request(
        site, robot, tcpros.encode({**tcpros.decode(subscriber_header(topic="/robot/none")[4:]), **fields})
    )
    assert answer["error"] == b"rossec: /robot does not publish /robot/none"


@pytest.mark.parametrize(
    ("pieces", "error"),
    [
        ((b"\xff\xff\xff\x7f",), b""),
        ((b"\4\0\0\0\xff\xff\xff\xff",), b""),
        ((subscriber_header(), subscriber_header()), b""),
        ((subscriber_header() + b"\1\0\0",), b"bytes after the connection header"),
        ((b"\0\0\0\0",), b"has no 'callerid'"),
    ],
)
async def test_malformed_headers_are_refused(
    site: Site, robot: Node, pieces: tuple[bytes, ...], error: bytes
) -> None:
    answer = await request(site, robot, *pieces)
    assert answer["error"].startswith(b"rossec: ")
    assert error in answer["error"]


async def test_a_header_may_arrive_in_several_units(site: Site, robot: Node) -> None:
    data = subscriber_header()
    answer = await request(site, robot, *(data[i : i + 7] for i in range(0, len(data), 7)))
    assert b"shows no grant" in answer["error"]


async def test_a_peer_that_sends_no_header_is_disconnected(
    site: Site, robot: Node, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(node, "HEADER_DEADLINE", 0.1)
    credentials = site.enroll("/viewer").credentials()
    _, port = robot.topic_endpoint()
    stream = await connect("127.0.0.1", port, unlimited(credentials, site.anchor.verify))
    await ended(stream)


async def test_each_port_accepts_one_protocol(site: Site, robot: Node) -> None:
    credentials = site.enroll("/viewer").credentials()
    _, topic_port = robot.topic_endpoint()
    slave_port = int(robot.uri.rstrip("/").rpartition(":")[2])
    for port, flavour in ((topic_port, WireProtocol.HTTP), (slave_port, WireProtocol.TCPROS)):
        with pytest.raises(PlainPeer):
            await connect("127.0.0.1", port, unlimited(credentials, site.anchor.verify), flavour)


async def test_the_slave_api_refuses_a_revoked_node(site: Site, robot: Node) -> None:
    credentials = site.enroll("/viewer").credentials()
    port = int(robot.uri.rstrip("/").rpartition(":")[2])
    dial = (credentials, site.anchor.verify)
    stream = await connect("127.0.0.1", port, unlimited(*dial), WireProtocol.HTTP)
    answer = await RpcClient(stream).call("requestTopic", "/viewer", "/t", [["TCPROS"]])
    assert isinstance(answer, list)
    assert answer[0] == 1
    await robot._membership.session.call(
        "rossec.updateRevocations", site.revoke(site.identity("/viewer").thumbprint)
    )
    await ended(stream)
    again = await connect("127.0.0.1", port, unlimited(*dial), WireProtocol.HTTP)
    answer = await RpcClient(again).call("requestTopic", "/viewer", "/t", [["TCPROS"]])
    assert isinstance(answer, list)
    assert (answer[0], "is revoked" in answer[1], answer[2]) == (-1, True, 0)
    await ended(again)


async def test_the_connections_of_one_identity_are_bounded(
    site: Site, robot: Node, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connections, "PEER_CONNECTIONS", 3)
    port = int(robot.uri.rstrip("/").rpartition(":")[2])

    async def connected(name: str) -> SecureStream[Identity]:
        who = site.enroll(name).credentials(), site.anchor.verify
        return await connect("127.0.0.1", port, unlimited(*who), WireProtocol.HTTP)

    callers = ["/viewer"] * 3 + ["/master"] * 4
    streams = [await connected(name) for name in callers]
    for name, stream in zip(callers, streams, strict=True):
        assert await RpcClient(stream).call("requestTopic", name, "/t", [["TCPROS"]])
    await ended(await connected("/viewer"))
    await streams[0].close()


async def test_a_caller_that_stays_is_disconnected(
    site: Site, robot: Node, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(slave_api, "DEADLINE", 0.1)
    credentials = site.enroll("/viewer").credentials()
    port = int(robot.uri.rstrip("/").rpartition(":")[2])
    dial = (credentials, site.anchor.verify)
    await ended(await connect("127.0.0.1", port, unlimited(*dial), WireProtocol.HTTP))


async def test_the_graph_right_allows_queries_and_the_admin_right_shutdown(site: Site, robot: Node) -> None:
    """`rosnode ping`, `info` and `kill`; no grant allows to control the node."""
    sees = site.grant("/operator", Right.GRAPH, "/robot")
    ends = site.grant("/operator", Right.ADMIN, "/robot")
    elsewhere = site.grant("/operator", Right.GRAPH | Right.ADMIN, "/other")
    stolen = site.grant("/viewer", Right.GRAPH | Right.ADMIN, "/robot")
    credentials = site.enroll("/operator").credentials()
    host, port = parse_uri(robot.uri)
    stream = await connect(host, port, unlimited(credentials, site.anchor.verify), WireProtocol.HTTP)
    client = RpcClient(stream)

    async def ask(method: str, *params: object) -> object:
        answer = await client.call(method, "/operator", *params)
        assert isinstance(answer, list)
        return answer[0]

    assert await ask("getPid") == -1
    for grants in ([], [elsewhere], [stolen]):
        assert await ask("rossec.presentGrants", encode([*grants])) == 1
        assert await ask("getPid") == await ask("shutdown", "bye") == -1
    assert await ask("rossec.presentGrants", encode([sees])) == 1
    for method, right in SLAVE_CALLS.items():
        if right is Right.GRAPH:
            assert await ask(method) == 1, method
    assert await client.call("getName", "/operator") == [1, "", "/robot"]
    assert await client.call("getUri", "/operator") == [1, "", robot.uri]
    assert await ask("shutdown", "bye") == await ask("publisherUpdate", "/t", []) == -1
    assert await ask("rossec.presentGrants", encode([ends])) == 1
    assert await ask("paramUpdate", "/p", 1) == -1
    assert await ask("shutdown", "bye") == 1
    await stream.close()


async def test_a_subscriber_with_a_grant_is_answered(site: Site, robot: Node) -> None:
    grant = site.subscribe("/viewer", "/robot/*")
    fields = fields_for("/viewer", "/robot/pose", [grant])
    credentials = site.enroll("/viewer").credentials()
    stream = await connect("127.0.0.1", robot.topic_endpoint()[1], unlimited(credentials, site.anchor.verify))
    await stream.send(tcpros.encode(fields))
    (answer,) = tcpros.FrameReader().feed(await stream.receive())
    assert tcpros.decode(answer)["type"] == POSE.encode()
    stream.abort("heard enough")
    none = await request(site, robot, tcpros.encode(fields | {"topic": "/robot/none"}))
    assert none == {"error": b"rossec: /robot does not publish /robot/none"}
    both = await request(site, robot, tcpros.encode(fields | {"service": "/robot/go"}))
    assert b"for a topic and for a service" in both["error"]
