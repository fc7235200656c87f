"""The life of a connection of a rospy process: revocation, a fork, hours without a message."""

from collections.abc import AsyncIterator
from pathlib import Path
from typing import Final

import pytest
import pytest_asyncio

from grants.model import Right
from tests.support.attacker import call, credentials
from tests.support.fleet import SECURE, Program, entitle, environment, program
from tests.support.site import Site

pytestmark = [pytest.mark.ros, pytest.mark.asyncio(loop_scope="module")]

FAST: Final = """
import struct
from rossec.inprocess import identity
import rossec.net.threads.secure_socket
rossec.net.threads.secure_socket.SLICE = struct.pack("ll", 1, 0)  # how often a reader looks at the clock
from rossec.channel.records import ChannelLimits
limits = dict.fromkeys(identity.WireProtocol, ChannelLimits(seconds=1))
identity.ACCEPTED = identity.DIALLED = limits
"""
ROBOT: Final = (
    SECURE
    + FAST
    + """
import os, rospy, sys, threading, time
from std_msgs.msg import String
from std_srvs.srv import Trigger
rospy.init_node("robot")
still = rospy.Publisher("/robot/still", String, queue_size=1, latch=True)
still.publish("once")
queued = rospy.Publisher("/robot/queued", String, queue_size=10)
direct = rospy.Publisher("/robot/direct", String, queue_size=None)
rospy.Service("/robot/work", Trigger, lambda request: (True, "done"))
def fork():
    pid = os.fork()
    if pid == 0:
        for topic in queued, direct:
            topic.publish("from the child")
        try:
            rospy.get_param("/robot/x")
        except Exception as error:
            sys.stdout.write(f"CHILD {error}\\n")  # in one piece: another thread writes too
            sys.stdout.flush()
        os._exit(0)
    os.waitpid(pid, 0)
    time.sleep(0.1)
    for topic in queued, direct:
        topic.publish("from the parent")
print("READY", flush=True)
for line in sys.stdin:
    fork()
"""
)
VIEWER: Final = (
    SECURE
    + FAST
    + """
import rospy, sys
from std_msgs.msg import String
from std_srvs.srv import Trigger
rospy.init_node("viewer")
def tell(line):
    sys.stdout.write(line + "\\n")  # in one piece: other threads write too
    sys.stdout.flush()
def hear(message, topic):
    tell(f"HEARD {topic} {message.data}")
for topic in "still", "queued", "direct":
    rospy.Subscriber("/robot/" + topic, String, hear, topic)
rospy.wait_for_service("/robot/work", timeout=30)
kept = rospy.ServiceProxy("/robot/work", Trigger, persistent=True)
tell(f"ANSWER {kept().message}")
for line in sys.stdin:
    tell(f"ANSWER {kept().message}")
"""
)
TOPICS: Final = ("/robot/still", "/robot/queued", "/robot/direct")


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def pair(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[tuple[Program, Program]]:
    directory: Path = tmp_path_factory.mktemp("life")
    async with Site(directory / "site").running() as site:
        entitle(site, "/robot", {Right.PUBLISH: TOPICS, Right.PROVIDE: ("/robot/work",)})
        entitle(site, "/viewer", {Right.SUBSCRIBE: TOPICS, Right.CALL: ("/robot/work",)})
        env = environment(site, directory / "logs")
        async with program(env, ROBOT, told=True) as robot, program(env, VIEWER, told=True) as viewer:
            await robot.read_until("READY")
            await viewer.read_until("ANSWER done")
            if "HEARD still" not in viewer.said:
                await viewer.read_until("HEARD still")
            yield robot, viewer
            for running in (robot, viewer):
                assert running.process.stdin is not None
                running.process.stdin.close()  # the end of the program


@pytest.mark.attack("forked-child")
async def test_a_forked_child_cannot_send(pair: tuple[Program, Program]) -> None:
    """Else two messages would be sent with one nonce."""
    robot, viewer = pair
    while not all(f"HEARD {topic} from the parent" in viewer.said for topic in ("queued", "direct")):
        await robot.tell("fork")
        assert "a forked process has no connections" in await robot.read_until("CHILD")
        await viewer.read_until("HEARD")
    assert "from the child" not in viewer.said
    assert "lost" not in viewer.said


@pytest.mark.attack("tampered-records")
async def test_idle_connections_renew_their_keys(pair: tuple[Program, Program]) -> None:
    """No message and no call for many periods of renewal: no connection is made again."""
    robot, viewer = pair
    await viewer.tell("call")
    await viewer.read_until("ANSWER done")
    with pytest.raises(TimeoutError):
        await viewer.read_until("HEARD still", within=5)
    await viewer.tell("call")
    await viewer.read_until("ANSWER done")
    assert viewer.said.count("HEARD still") == 1
    for word in ("lost", "Traceback", "follow"):
        assert word not in robot.said + viewer.said, robot.said + viewer.said


CHATTERER: Final = (
    SECURE
    + """
import rospy, time
from std_msgs.msg import String
rospy.init_node("chatterer")
words = rospy.Publisher("/chatterer/words", String, queue_size=1000)
while not rospy.is_shutdown():
    words.publish("x" * 1000)
    time.sleep(0.001)
"""
)
DREAMER: Final = (
    SECURE
    + """
import rospy, time
from std_msgs.msg import String
rospy.init_node("dreamer")
def hear(message):
    print("HEARD", flush=True)
    time.sleep(0.05)
rospy.Subscriber("/chatterer/words", String, hear)
rospy.spin()
"""
)


@pytest.mark.attack("outlived-right")
async def test_queued_messages_of_a_revoked_publisher_are_discarded(tmp_path: Path) -> None:
    """D2: the callback is slow, so thousands of messages are queued when the list arrives."""
    async with Site(tmp_path / "site").running() as site:
        grant = site.publish("/chatterer", "/chatterer/words")
        site.subscribe("/dreamer", "/chatterer/words")
        env = environment(site, tmp_path / "logs")
        async with program(env, DREAMER) as dreamer, program(env, CHATTERER):
            for _ in range(20):
                await dreamer.read_until("HEARD")
            data = site.revoke(grant)
            assert site.master is not None
            own = credentials(site, "/carrier")
            await call(site.master.uri, own, "rossec.updateRevocations", "/carrier", data)
            await dreamer.read_until("closed the connection with /chatterer")
            dreamer.said = ""
            with pytest.raises(TimeoutError):
                await dreamer.read_until("\0", within=1)
    assert dreamer.said.count("HEARD") <= 1, "the one that was being heard"


PATIENT: Final = (
    SECURE
    + """
import rospy
from std_msgs.msg import String
rospy.init_node("patient")
rospy.Subscriber("/robot/words", String, lambda message: print("HEARD", message.data, flush=True))
rospy.spin()
"""
)


@pytest.mark.attack("node-load")
async def test_a_flooded_publisher_is_connected_afterwards(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """N8: its half-open slots are in use when a subscriber connects, which tries again."""
    async with Site(tmp_path / "site").running() as site:
        site.publish("/robot", "/robot/words")
        site.subscribe("/patient", "/robot/words")
        async with site.node("/robot") as robot:
            words = await robot.publisher("/robot/words", "std_msgs/String", latch=True)
            words.publish(words.create(data="at last"))
            topics = robot._listener._servers[1]
            with monkeypatch.context() as siege:
                siege.setattr(topics, "_admit", lambda _: None)
                async with program(environment(site, tmp_path / "logs"), PATIENT) as patient:
                    await patient.read_until("cannot connect to 127.0.0.1")
                    siege.undo()
                    await patient.read_until("HEARD at last")
