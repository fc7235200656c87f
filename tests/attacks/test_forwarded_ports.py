"""A relay that leads connections elsewhere: a forwarded port is an address, and no address is trusted.

The slave API that a forwarded port leads to is the right one, so that the node goes on to ask for the topic.
"""

import asyncio
import contextlib
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from ca.certificates import Identity
from ca.encoding import encode
from grants.errors import GrantMissing
from grants.model import Right
from rossec.errors import IdentityRefused, PlainPeer, RossecError
from rossec.net.aio import SecureStream, serve
from rossec.participant.access import FIELD
from rossec.participant.message_types import message_type
from rossec.ros import tcpros
from rossec.ros.names import MASTER, parse_uri
from tests.rossec.sidecar.program import Program, sidecar
from tests.support.attacker import EVE, HOST, call, credentials
from tests.support.contexts import unlimited
from tests.support.forwarded_ports import ForwardedPort, forwarded_port
from tests.support.site import Site
from tests.support.victim import COMMAND, TYPE, attacked
from tests.support.witness import POSE, TOPIC, Witness, until

pytestmark = pytest.mark.attack("lying-forwarded-port")


@contextlib.asynccontextmanager
async def false_topic(site: Site, name: str, topic: str, kind: str) -> AsyncIterator[int]:
    """A TCPROS port of the enrolled node `name`, which has no right to publish; it does at once."""
    shape, own = message_type(kind), site.enroll(name)
    fields: dict[str, str | bytes] = {
        "callerid": name,
        "topic": topic,
        "type": shape.name,
        "md5sum": shape.md5sum,
        FIELD: encode(list(own.grants())),
    }
    lie = tcpros.frame(bytes(shape.serialize(shape.create())))

    async def lies(stream: SecureStream[Identity]) -> None:
        await stream.receive()
        await stream.send(tcpros.encode(fields), lie)
        await stream.wait_ended()

    context = unlimited(own.credentials(), site.anchor.verify)
    async with serve(lies, HOST, 0, context) as server:
        yield server.port


@contextlib.asynccontextmanager
async def plain_port() -> AsyncIterator[int]:
    """A port of a plain program, which answers a header with a header."""

    async def answer(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(tcpros.encode({"callerid": "/robot", "md5sum": "*", "type": "*"}))
        await writer.drain()
        writer.close()

    server = await asyncio.start_server(answer, HOST, 0)
    async with server:
        yield int(server.sockets[0].getsockname()[1])


async def led(site: Site, witness: Witness, found: ForwardedPort) -> type[Exception]:
    """Let the master name a forwarded port besides the true publisher; how the viewer refuses it."""
    both = [witness.robot.uri, found.uri]
    own = credentials(site, MASTER)
    told = await call(witness.viewer.uri, own, "publisherUpdate", MASTER, TOPIC, both)
    assert told == [1, "", 0]
    refusals = witness.subscriber.refusals
    await until(lambda: len(refusals) > 0)
    assert len(witness.subscriber.links) == 1
    return type(refusals[0])


async def test_a_node_without_the_right_is_refused_behind_a_forwarded_port(
    site: Site, witness: Witness
) -> None:
    api = parse_uri(witness.robot.uri)[1]
    async with false_topic(site, EVE, TOPIC, POSE) as port:
        with forwarded_port(api, port) as found:
            assert await led(site, witness, found) is GrantMissing


async def test_a_forwarded_port_does_not_lead_a_node_back_to_itself(site: Site, witness: Witness) -> None:
    own = parse_uri(witness.viewer.uri)[1]
    with forwarded_port(own, own) as found:
        assert await led(site, witness, found) is IdentityRefused


async def test_a_plain_program_is_refused_behind_a_forwarded_port(site: Site, witness: Witness) -> None:
    async with plain_port() as port:
        with forwarded_port(parse_uri(witness.robot.uri)[1], port) as found:
            assert await led(site, witness, found) is PlainPeer


@pytest.mark.ros
async def test_rospy_refuses_what_a_forwarded_port_leads_to(tmp_path: Path) -> None:
    async with attacked(tmp_path) as victim:
        own, site = credentials(victim.site, MASTER), victim.site
        async with (
            site.node("/honest") as honest,
            false_topic(site, EVE, COMMAND, TYPE) as false,
            plain_port() as plain,
        ):
            for port, said in (
                (false, "cannot subscribe /robot/command: no grant for publish"),
                (plain, "the peer is a plain ROS node"),
                (victim.port, "this node's own certificate"),
            ):
                with forwarded_port(parse_uri(honest.uri)[1], port) as found:
                    update = "publisherUpdate", MASTER, COMMAND, [found.uri]
                    assert await call(victim.uri, own, *update) == [1, "", 0]
                    await until(lambda said=said: said in victim.said, within=20)  # type: ignore[misc]
        await victim.goes_on()  # and has obeyed nobody


@pytest.mark.parametrize("kind", ["without the right", "plain"])
async def test_a_sidecar_refuses_what_a_forwarded_port_leads_to(site: Site, kind: str) -> None:
    for name, right in (("/talker", Right.PUBLISH), ("/listener", Right.SUBSCRIBE)):
        site.grant(name, right, "/word")
    assert site.master is not None
    async with (
        sidecar(site) as running,
        Program("/listener", running) as listener,
        site.node("/honest") as honest,
        false_topic(site, EVE, "/word", TYPE) as false,
        plain_port() as plain,
    ):
        port = false if kind == "without the right" else plain
        with forwarded_port(parse_uri(honest.uri)[1], port) as found:
            own, grants = credentials(site, "/talker"), site.enroll("/talker").grants()
            for method, *params in (
                ("rossec.presentGrants", grants),
                ("registerPublisher", "/word", TYPE, found.uri),
            ):
                answer = await call(site.master.uri, own, str(method), "/talker", *params)
                assert isinstance(answer, list)
                assert answer[0] == 1, answer
            uris = await listener.register("registerSubscriber", "/word", TYPE)
            assert isinstance(uris, list)
            if port == plain:
                with pytest.raises(RossecError):  # it hangs up
                    await listener.subscribe(uris[0], "/word")
            else:
                _, fields = await listener.subscribe(uris[0], "/word")
                assert fields["error"].startswith(b"rossec: no grant for publish on /word")
