"""A peer with a limited right connects to a rospy node again, or many times.

The rate of these grants lets one message through, and the next one after a quarter of an hour. The
robot publishes all the while, so whatever more arrives was gained by the attack.
"""

import asyncio
import contextlib
import struct
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any, Final

import pytest
import pytest_asyncio

from ca.encoding import encode
from grants.model import Restriction, Right, filter_rules
from rossec.errors import ChannelError
from rossec.net.aio import SecureStream, connect
from rossec.participant.access import FIELD
from rossec.ros import tcpros
from rossec.ros.tcpros import FrameReader
from tests.support.attacker import EVE, HOST, fields_for
from tests.support.contexts import unlimited
from tests.support.fleet import SECURE, Program, entitle, environment, program
from tests.support.site import Site
from tests.support.witness import until

pytestmark = [pytest.mark.ros, pytest.mark.asyncio(loop_scope="module")]
COUNT: Final = "/robot/count"
PLACE: Final = "/robot/place"
PLAN: Final = "/robot/plan"
COMMAND: Final = "/robot/command"
SERVICE: Final = "/robot/reset"
SELDOM: Final = Restriction(rate=0.001)
HELD: Final = Restriction(
    "std_msgs/Float64", (), filter_rules({"data": {"round": {"step": 2.0, "hysteresis": 0.5}}})
)

ROBOT: Final = (
    SECURE
    + """
import rospy, rospy.impl.tcpros_base, threading
from std_msgs.msg import Float64, Int32, String
from std_srvs.srv import Trigger, TriggerResponse
rospy.init_node("robot")
count = rospy.Publisher("/robot/count", Int32, queue_size=1000)
place = rospy.Publisher("/robot/place", Float64, queue_size=1000)
plan = rospy.Publisher("/robot/plan", Int32, queue_size=1000, latch=True)
rospy.Subscriber("/robot/command", String, lambda m: print("COMMANDED", m.data, flush=True))
rospy.Service("/robot/reset", Trigger, lambda asked: TriggerResponse(True, "done"))
print("AT", rospy.impl.tcpros_base.get_tcpros_server_address()[1], flush=True)
number = 0
try:
    while not rospy.is_shutdown():
        number += 1
        count.publish(number)
        place.publish(0.9 if number % 2 else 1.1)
        plan.publish(number)
        rospy.sleep(0.005)
except rospy.ROSException:
    pass
"""
)


class Target:
    """The robot, and Eve's connections to it."""

    def __init__(self, site: Site, robot: Program, port: int) -> None:
        self.site = site
        self.robot = robot
        self.port = port

    async def connect(self, fields: dict[str, Any]) -> SecureStream[Any]:
        """One more connection of Eve's, with its header answered."""
        credentials, verify = self.site.enroll(EVE).credentials(), self.site.anchor.verify
        stream = await connect(HOST, self.port, unlimited(credentials, verify))
        await stream.send(tcpros.encode(fields))
        return stream

    async def subscribe(self, topic: str) -> "Receiver":
        fields = fields_for(EVE, topic, self.site.enroll(EVE).grants())
        return Receiver(await self.connect(fields))


class Receiver:
    """What one connection has received."""

    def __init__(self, stream: SecureStream[Any]) -> None:
        self.stream = stream
        self.frames = FrameReader()
        self.found: list[bytes] = []

    async def first(self, count: int = 1) -> bytes:
        """The first message, when `count` of them are here; the header comes before it."""
        async with asyncio.timeout(30):
            while len(self.found) <= count:
                self.found += self.frames.feed(await self.stream.receive())
        return self.found[1]

    async def rest(self) -> list[bytes]:
        """All messages; the robot has sent all that it forwards."""
        with contextlib.suppress(TimeoutError, ChannelError):
            while True:
                async with asyncio.timeout(0.3):
                    self.found += self.frames.feed(await self.stream.receive())
        self.stream.abort("done")
        return self.found[1:]


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def target(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Target]:
    directory: Path = tmp_path_factory.mktemp("limits")
    async with Site(directory / "site").running() as site:
        entitle(
            site,
            "/robot",
            {Right.PUBLISH: (COUNT, PLACE, PLAN), Right.SUBSCRIBE: (COMMAND,), Right.PROVIDE: (SERVICE,)},
        )
        site.enroll(EVE, wildcard=True)
        for topic, restriction in ((COUNT, SELDOM), (PLACE, HELD), (PLAN, SELDOM)):
            site.subscribe(EVE, topic, restriction)
        site.grant(EVE, Right.CALL, SERVICE, restriction=SELDOM)
        site.grant(EVE, Right.PUBLISH, COMMAND, restriction=SELDOM)
        async with program(environment(site, directory / "logs"), ROBOT) as robot:
            port = int((await robot.read_until("AT ")).split()[1])
            yield Target(site, robot, port)


@pytest.mark.attack("more-by-reconnecting")
async def test_many_connections_count_as_one_receiver(target: Target) -> None:
    ears = [await target.subscribe(COUNT)]
    once = await ears[0].first()
    ears += [await target.subscribe(COUNT) for _ in range(10)]
    heard = [await ear.rest() for ear in ears]
    assert heard == [[once], *[[]] * 10]


@pytest.mark.attack("more-by-reconnecting")
async def test_a_new_connection_does_not_reset_hysteresis(target: Target) -> None:
    """The value alternates about a boundary, 0.9 and 1.1: rounding alone would show both cells."""
    seen: set[tuple[float]] = set()
    for _ in range(12):
        ear = await target.subscribe(PLACE)
        await ear.first(5)
        ear.stream.abort("done")
        seen.update(struct.unpack("<d", message) for message in ear.found[1:])
    assert len(seen) == 1


@pytest.mark.attack("more-by-reconnecting")
async def test_a_latched_message_is_not_a_new_sample(target: Target) -> None:
    """A peer that connects again gets the message it had, whatever was published since."""
    once = await (await target.subscribe(PLAN)).first()
    for _ in range(4):
        ear = await target.subscribe(PLAN)
        assert await ear.first() == once
        assert await ear.rest() == [once]


@pytest.mark.attack("more-by-reconnecting")
async def test_calls_over_many_connections_share_the_rate(target: Target) -> None:
    answers = []
    grants = encode([*target.site.enroll(EVE).grants()])
    for persistent in ("0", "1") * 3:
        fields = {"callerid": EVE, "service": SERVICE, "md5sum": "*", "persistent": persistent, FIELD: grants}
        stream = await target.connect(fields)
        async with asyncio.timeout(30):
            assert b"md5sum" in await stream.receive()
            await stream.send(tcpros.frame(b""))
            answers.append((await stream.receive())[:1])
        stream.abort("done")
    assert answers == [b"\1", *[b"\0"] * 5]


@pytest.mark.attack("more-by-reconnecting")
async def test_a_key_that_publishes_under_many_names_has_one_rate(target: Target) -> None:
    """Four anonymous nodes of one key; the robot obeys once."""
    async with contextlib.AsyncExitStack() as stack:
        for place in range(4):
            node = await stack.enter_async_context(target.site.node(f"{EVE}_{place}"))
            publisher = await node.publisher(COMMAND, "std_msgs/String")
            await publisher.wait_for_subscribers()
            publisher.publish(publisher.create(data=f"go {place}"))
            await until(lambda: not any(queue._queue for queue in publisher.links.values()))  # noqa: B023 - at once
        assert await target.robot.read_until("COMMANDED") == "COMMANDED go 0"
        with pytest.raises(TimeoutError):
            await target.robot.read_until("COMMANDED", within=1.5)
