"""SidecarTarget a sidecar, a holder of a limited right connects again and again."""

import asyncio
import contextlib
import struct
from collections.abc import AsyncIterator
from dataclasses import replace

import pytest

from ca.certificates import Identity
from ca.encoding import encode
from grants.model import Restriction, Right, filter_rules
from rossec.net.aio import SecureStream, WireProtocol, connect
from rossec.net.rpc.calls import RpcClient
from rossec.participant.message_types import message_type
from rossec.ros import tcpros
from rossec.ros.tcpros import FrameReader
from rossec.sidecar.server import Sidecar
from tests.rossec.sidecar.program import Program, sidecar, string_message
from tests.support.attacker import EVE, HOST, fields_for
from tests.support.contexts import unlimited
from tests.support.limited import HELD, NEAR_A_BOUNDARY, ONE_MESSAGE, SELDOM, TOPIC, messages, number
from tests.support.site import Site
from tests.support.witness import until


class Number(Program):
    """A program that publishes numbers, not texts."""

    definition = b"float64 data\n"
    kind = b"std_msgs/Float64"
    md5sum = b"fdb28210bfa9d7c91146260178d9a584"


@contextlib.asynccontextmanager
async def program(site: Site, kind: type[Program] = Program) -> AsyncIterator["SidecarTarget"]:
    """/robot, a plain program that publishes behind a sidecar."""
    site.publish("/robot", TOPIC)
    async with sidecar(site) as near, kind("/robot", near) as robot:
        await robot.register("registerPublisher", TOPIC, kind.kind.decode())
        yield SidecarTarget(site, robot, port_of(near))


def port_of(near: Sidecar) -> int:
    """The port of the program of /robot that registered last."""
    return [port.port for port in near._agent_for("/robot")._ingress.ports][-1]


class SidecarTarget:
    """Eve's connections to a program behind a sidecar."""

    def __init__(self, site: Site, robot: Program, port: int) -> None:
        self.site = site
        self.robot = robot
        self.port = port

    async def connect(self) -> SecureStream[Identity]:
        """One more; the program knows of it."""
        credentials, verify = self.site.enroll(EVE).credentials(), self.site.anchor.verify
        grants = self.site.enroll(EVE).grants()
        slave = await connect(HOST, self.port, unlimited(credentials, verify), WireProtocol.HTTP)
        client = RpcClient(slave)
        await client.call("rossec.presentGrants", EVE, encode([*grants]))
        answer = await client.call("requestTopic", EVE, TOPIC, [["TCPROS"]])
        assert isinstance(answer, list), answer
        await client.close()
        before = len(self.robot.connections)
        stream = await connect(HOST, answer[2][2], unlimited(credentials, verify))
        await stream.send(tcpros.encode(fields_for(EVE, TOPIC, grants)))
        await until(lambda: len(self.robot.connections) == before + 1)
        return stream

    async def heard(self, *streams: SecureStream[Identity]) -> list[list[bytes]]:
        """All that each was sent; the program closes the connections."""
        for connection in self.robot.connections:
            await connection.close()
        self.robot.connections.clear()
        return [(await messages(stream))[1:] for stream in streams]


@pytest.mark.attack("more-by-reconnecting")
async def test_a_new_connection_to_a_sidecar_does_not_reset_the_rate(site: Site) -> None:
    site.subscribe(EVE, TOPIC, ONE_MESSAGE)
    async with program(site) as eve:
        found = []
        for text in ("one", "two", "six", "ten"):
            stream = await eve.connect()
            await eve.robot.connections[-1].send(string_message(text))
            found += await eve.heard(stream)
        assert found == [[string_message("one")[4:]], [], [], []]


@pytest.mark.attack("more-by-reconnecting")
async def test_a_sidecar_forwards_copies_on_every_connection(site: Site) -> None:
    """The program sends a copy to each: a second connection of the same key must get it."""
    site.subscribe(EVE, TOPIC, ONE_MESSAGE)
    async with program(site) as eve:
        streams = [await eve.connect() for _ in range(5)]
        for text in ("one", "two", "one"):
            for connection in eve.robot.connections:
                await connection.send(string_message(text))
        assert await eve.heard(*streams) == [[string_message("one")[4:]]] * 5


@pytest.mark.attack("more-by-reconnecting")
async def test_a_new_connection_to_a_sidecar_does_not_reset_hysteresis(site: Site) -> None:
    site.subscribe(EVE, TOPIC, HELD)
    async with program(site, Number) as eve:
        found = []
        for value in NEAR_A_BOUNDARY:
            stream = await eve.connect()
            await eve.robot.connections[-1].send(tcpros.frame(number(value)))
            found += await eve.heard(stream)
        assert found == [[number(0)]] * len(NEAR_A_BOUNDARY)


@pytest.mark.attack("more-by-reconnecting")
async def test_new_program_names_behind_a_sidecar_do_not_reset_limits(site: Site) -> None:
    """`rostopic pub` has a new name in each run: without a limit each would use memory for good.

    Programs that run at the same time have separate limits.
    """
    site.enroll("/robot", wildcard=True)
    site.publish("/robot", TOPIC)
    site.subscribe(EVE, TOPIC, replace(HELD, rate=SELDOM))
    found: dict[int, list[list[bytes]]] = {}
    async with sidecar(site) as near, Number("/robot_0", near) as first:
        await first.register("registerPublisher", TOPIC, "std_msgs/Float64")
        live = SidecarTarget(site, first, port_of(near))
        for run in range(3):
            found[run] = []
            async with Number(f"/robot_{run + 1}", near) as robot:
                await robot.register("registerPublisher", TOPIC, "std_msgs/Float64")
                for eve in (live, SidecarTarget(site, robot, port_of(near))):
                    stream = await eve.connect()
                    await eve.robot.connections[-1].send(tcpros.frame(number(run)))
                    found[run] += await eve.heard(stream)
    assert found == {0: [[number(0)]] * 2, 1: [[], []], 2: [[], []]}


@pytest.mark.attack("more-by-reconnecting")
async def test_a_sidecar_sends_a_new_connection_what_its_key_received(site: Site) -> None:
    """A latching program sends its newest message to each new connection."""
    site.subscribe(EVE, TOPIC, ONE_MESSAGE)
    async with program(site) as eve:
        eve.robot.latching = True
        for text in ("one", "two", "six"):
            stream = await eve.connect()
            await eve.robot.connections[-1].send(string_message(text))
            assert await eve.heard(stream) == [[string_message("one")[4:]]]


@pytest.mark.attack("more-by-reconnecting")
async def test_a_new_connection_does_not_reset_a_publishers_rate(site: Site) -> None:
    """Programs that run at the same time are separate receivers, in any order."""
    site.subscribe("/robot", TOPIC)
    site.grant(EVE, Right.PUBLISH, TOPIC, restriction=ONE_MESSAGE)
    found = []
    async with sidecar(site) as near, Program("/robot", near) as one:
        async with site.node(EVE) as node:
            publisher = await node.publisher(TOPIC, "std_msgs/String")
            uris = await one.register("registerSubscriber", TOPIC, "std_msgs/String")
            assert isinstance(uris, list)
            (uri,) = uris
            for names in (("/robot", "/other"), ("/other", "/robot"), ("/third",)):
                streams = []
                for one.name in names:
                    streams.append((await one.subscribe(uri, TOPIC))[0])
                await publisher.wait_for_subscribers(len(names))
                publisher.publish_bytes(string_message("go")[4:])
                for link, queue in tuple(publisher.links.items()):
                    await until(lambda: not queue._queue)  # noqa: B023 - at once
                    await link.stream.close()
                found += [await messages(stream) for stream in streams]
                await until(lambda: not publisher.links)
        gone: tuple[str, tuple[object, ...]] = ("publisherUpdate", ("/master", TOPIC, []))
        await until(lambda: gone in one.calls)
    assert found == [[string_message("go")[4:]]] * 2 + [[]] * 3


class Pose(Program):
    """A program that publishes poses, in messages of any length."""

    definition = message_type("geometry_msgs/PoseStamped").definition.encode()
    kind = b"geometry_msgs/PoseStamped"
    md5sum = message_type("geometry_msgs/PoseStamped").md5sum.encode()


def pose(x: float, length: int = 0) -> bytes:
    """With its length in front; its frame_id has `length` bytes."""
    frame = struct.pack("<IIII", 0, 0, 0, length) + bytes(length)
    return tcpros.frame(frame + struct.pack("<7d", x, *[0.0] * 6))


async def positions(stream: SecureStream[Identity], frames: FrameReader, count: int) -> list[float]:
    """The next `count` of x."""
    found: list[bytes] = []
    while len(found) < count:
        found += frames.feed(await stream.receive())
    return [struct.unpack_from("<d", each, len(each) - 56)[0] for each in found]


@pytest.mark.attack("slow-to-set-hysteresis-anew")
async def test_an_unread_connection_does_not_reset_hysteresis(site: Site) -> None:
    """An old place that is evaluated late would reset the hysteresis for the next one."""
    rules = filter_rules({"pose.position.x": {"round": {"step": 2.0, "hysteresis": 0.5}}})
    site.subscribe(EVE, TOPIC, Restriction("geometry_msgs/PoseStamped", (), rules))
    async with asyncio.timeout(120), program(site, Pose) as eve:
        live, slow = [await eve.connect() for _ in range(2)]
        to_live, to_slow = eve.robot.connections
        frames = FrameReader()
        await skip_header(live, frames)
        sending = asyncio.ensure_future(to_slow.send(pose(10.0, 1 << 20) * 40))
        await asyncio.wait({sending}, timeout=5)  # all of it, unless the sidecar waits for the reader
        for _ in range(2000):  # turns of the loop, each of which reads what there is
            await asyncio.sleep(0)
        await to_live.send(pose(0.9))
        found = await positions(live, frames, 1)
        with contextlib.suppress(TimeoutError):
            while True:
                async with asyncio.timeout(2):
                    await slow.receive()
        await to_live.send(pose(1.1))
        found += await positions(live, frames, 1)
        assert found == [0.0, 0.0]
        for stream in (live, slow):
            stream.abort("done")
        await asyncio.wait({sending})


async def skip_header(stream: SecureStream[Identity], frames: FrameReader) -> None:
    """The connection header, which comes first."""
    while not frames.feed(await stream.receive()):
        pass
