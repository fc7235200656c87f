"""A restricted publisher sends a definition that differs from the one its subscribers use.

ROS's md5 forgets array brackets behind the name of a message type: both forgeries below have the
md5 of geometry_msgs/Twist. A guard that used them would filter other bytes than the receiver reads.
"""

import contextlib
import dataclasses
import struct
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Final

import pytest

from grants.filters import layout
from grants.model import Restriction, Right, filter_rules
from rossec.node import Publisher, message_type
from rossec.participant.handshakes import Fields
from rossec.participant.handshakes import TopicEndpoint as Topic
from rossec.ros.tcpros import FrameReader
from tests.rossec.sidecar.program import Program, sidecar
from tests.support.fleet import SECURE, entitle, environment, program
from tests.support.sidecarprogram import subscribed
from tests.support.site import Site

TWIST: Final = "geometry_msgs/Twist"
TRUE: Final = message_type(TWIST)
OWN: Final = "my_robot/Drive"
DRIVE: Final = "/drive"
CLAMPED: Final = "/clamped"
TURNING: Final = "/turning"
CLAMP: Final = filter_rules({"linear": {"clamp": {"low": -0.5, "high": 0.5}}})
LIMITS: Final = {
    CLAMPED: Restriction(TWIST, (), CLAMP),
    TURNING: Restriction(TWIST, ("msg.angular.x < 50.0",)),
}
FORGERIES: Final = {
    # The clamped field is empty; the receiver reads the angular speed from other bytes.
    CLAMPED: "geometry_msgs/Vector3[0] linear\ngeometry_msgs/Vector3[2] angular",
    TURNING: "geometry_msgs/Vector3[0] linear\ngeometry_msgs/Vector3 angular",
}
FAST: Final = struct.pack("<6d", 9.9, 0, 0, 1000, 0, 0)
SLOWED: Final = struct.pack("<6d", 0.5, 0, 0, 1000, 0, 0)
CALM: Final = struct.pack("<6d", 0.25, 0, 0, 0.25, 0, 0)
HEARD: Final = {CLAMPED: [SLOWED, CALM], TURNING: [CALM]}

pytestmark = pytest.mark.attack("forged-layout")
topics = pytest.mark.parametrize("topic", [CLAMPED, TURNING])


@pytest.fixture
async def site(tmp_path: Path) -> AsyncIterator[Site]:
    site = Site(tmp_path / "site")
    for topic, limit in LIMITS.items():
        site.grant("/mallory", Right.PUBLISH, topic, restriction=limit)
    entitle(site, "/robot", {Right.SUBSCRIBE: (CLAMPED, TURNING)})
    async with site.running() as site:
        yield site


def forged(topic: str) -> str:
    vector = "MSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n"
    definition = f"{FORGERIES[topic]}\n{'=' * 80}\n{vector}"
    assert layout.parse(TWIST, definition).md5 == TRUE.md5sum
    return definition


@contextlib.asynccontextmanager
async def mallory(site: Site, topic: str, **changes: str) -> AsyncIterator[Publisher]:
    """Publishes `topic` with any definition."""
    async with site.node("/mallory") as node:
        publisher = await node.publisher(topic, TWIST)
        said = dataclasses.replace(TRUE, **{"definition": forged(topic), **changes})
        publisher.endpoint = Topic(topic, said)
        yield publisher


@topics
async def test_a_built_in_node_uses_its_own_definition(site: Site, topic: str) -> None:
    heard: list[bytes] = []
    async with mallory(site, topic) as publisher, site.node("/robot") as robot:
        subscriber = await robot.subscriber(topic, TWIST)
        await publisher.wait_for_subscribers()
        for message in (FAST, CALM):
            publisher.publish_bytes(message)
        async for message in subscriber.raw():
            heard.append(message)
            if message == CALM:
                break
    assert heard == HEARD[topic]


ROBOT: Final = (
    SECURE
    + """
import rospy, struct, sys
from geometry_msgs.msg import Twist
rospy.init_node("robot")
def obey(message):
    if sys.argv[2] == "typed":
        print("HEARD", message.linear.x, message.angular.x, flush=True)
    else:
        said = message._connection_header["message_definition"]
        print("HEARD", *struct.unpack("<6d", message._buff)[::3], "[" in said, flush=True)
rospy.Subscriber(sys.argv[1], Twist if sys.argv[2] == "typed" else rospy.AnyMsg, obey)
rospy.spin()
"""
)


@pytest.mark.ros
@topics
@pytest.mark.parametrize("reads", ["typed", "any"])
async def test_rospy_uses_the_class_it_reads_with(site: Site, tmp_path: Path, topic: str, reads: str) -> None:
    """A program that takes any type gets the definition the guard was built from."""
    env = environment(site, tmp_path / "logs")
    async with mallory(site, topic) as publisher, program(env, ROBOT, topic, reads) as robot:
        await publisher.wait_for_subscribers()
        for message in (FAST, CALM):
            publisher.publish_bytes(message)
        await robot.read_until("HEARD 0.25 0.25")
    lines = [line for line in robot.said.splitlines() if line.startswith("HEARD")]
    expected = {CLAMPED: ["HEARD 0.5 1000.0", "HEARD 0.25 0.25"], TURNING: ["HEARD 0.25 0.25"]}
    assert lines == [line + " False" * (reads == "any") for line in expected[topic]]


OF_ROSCPP: Final = {"type": TWIST.encode(), "md5sum": TRUE.md5sum.encode()}
OF_ROSPY: Final = {**OF_ROSCPP, "message_definition": TRUE.definition.encode()}
OF_ROSBAG: Final = {"type": b"*", "md5sum": b"*"}


@topics
@pytest.mark.parametrize("fields", [OF_ROSCPP, OF_ROSPY, OF_ROSBAG], ids=["cpp", "py", "any"])
async def test_a_sidecar_uses_the_definition_of_its_program_or_host(
    site: Site, topic: str, fields: Fields
) -> None:
    async with sidecar(site) as near, mallory(site, topic) as publisher, Program("/robot", near) as robot:
        stream, answer = await subscribed(robot, topic, fields)
        await publisher.wait_for_subscribers()
        for message in (FAST, CALM):
            publisher.publish_bytes(message)
        frames, heard = FrameReader(), list[bytes]()
        while CALM not in heard:
            heard += frames.feed(await stream.receive())
        assert heard == HEARD[topic]
        assert b"[" not in answer["message_definition"], "and is told what the guard reads by"


async def driven(site: Site, robot: Program, heard: list[bytes]) -> Fields:
    """Mallory publishes a custom type of the robot, forged; what its program receives."""
    said = dataclasses.replace(TRUE, name=OWN, definition=forged(CLAMPED))
    async with site.node("/mallory") as node:
        publisher = await node.publisher(DRIVE, TWIST)
        publisher.endpoint = Topic(DRIVE, said)
        stream, answer = await subscribed(robot, DRIVE, {**OF_ROSCPP, "type": OWN.encode()})
        if "error" not in answer:
            await publisher.wait_for_subscribers()
            publisher.publish_bytes(FAST)
            frames = FrameReader()
            while not heard:
                heard += frames.feed(await stream.receive())
        stream.abort()
    return answer


async def test_a_sidecar_reads_a_custom_type_from_its_package_or_refuses(
    site: Site, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """roscpp's header has no message definition."""
    site.grant("/mallory", Right.PUBLISH, DRIVE, restriction=Restriction(OWN, (), CLAMP))
    site.subscribe("/robot", DRIVE)
    heard: list[bytes] = []
    async with sidecar(site) as near, Program("/robot", near) as robot:
        answer = await driven(site, robot, heard)
        assert answer.keys() == {"error"}
        assert b"how this subscriber reads a my_robot/Drive is not known here" in answer["error"]
        (tmp_path / "ws" / "my_robot" / "msg").mkdir(parents=True)
        own = "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n"
        (tmp_path / "ws" / "my_robot" / "msg" / "Drive.msg").write_text(own)
        monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path / "ws"))
        answer = await driven(site, robot, heard)
        assert answer["message_definition"].startswith(own.encode())
    assert heard == [SLOWED]
