"""A secured rospy node that is attacked, and a viewer beside it that must not be disturbed."""

import asyncio
import contextlib
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from ca.encoding import encode
from grants.model import Right
from rossec.node import Node, Subscriber
from rossec.participant.access import FIELD
from rossec.ros.names import parse_uri
from tests.support.fleet import SECURE, Program, entitle, environment, program
from tests.support.site import Site
from tests.support.witness import until

NAME: Final = "/robot"
STATE: Final = "/robot/state"
COMMAND: Final = "/robot/command"
SERVICE: Final = "/robot/reset"
PARAMETER: Final = "/robot/speed"
TYPE: Final = "std_msgs/String"

ROBOT: Final = (
    SECURE
    + """
import rospy, rospy.impl.tcpros_base
from std_msgs.msg import String
from std_srvs.srv import Trigger, TriggerResponse
rospy.init_node("robot")
rospy.set_param("/robot/speed", 1)
rospy.get_param_cached("/robot/speed")
state = rospy.Publisher("/robot/state", String, queue_size=1000)
def obey(message):
    print(f"COMMANDED {message.data}\\n", end="", flush=True)
rospy.Subscriber("/robot/command", String, obey)
def reset(request):
    print("RESET", flush=True)
    return TriggerResponse(True, "done")
rospy.Service("/robot/reset", Trigger, reset)
print("AT", rospy.get_node_uri(), rospy.impl.tcpros_base.get_tcpros_server_address()[1], flush=True)
number = 0
try:
    while not rospy.is_shutdown():
        state.publish("%d %s" % (number, rospy.get_param_cached("/robot/speed")))
        number += 1
        rospy.sleep(0.005)
except rospy.ROSException:  # as in stock rospy: it ended between the question and the publishing
    pass
print("ENDED", flush=True)
"""
)


@dataclass
class Victim:
    """The robot, a separate process; the viewer, a node of this process."""

    site: Site
    program: Program
    uri: str
    port: int
    viewer: Node
    sight: Subscriber
    numbers: list[int]
    last: str = ""

    @property
    def said(self) -> str:
        """All its output so far."""
        return self.program.said

    async def goes_on(self, messages: int = 10) -> None:
        """More messages arrive, all numbers in order; the robot has executed no command."""
        wanted = len(self.numbers) + messages
        await until(lambda: len(self.numbers) >= wanted, within=20)
        first = self.numbers[0]
        assert self.numbers == list(range(first, first + len(self.numbers)))
        assert self.last.endswith(" 1"), "its parameter was changed"
        for word in ("COMMANDED", "RESET", "ENDED", "Traceback"):
            assert word not in self.said, self.said

    async def listen(self) -> None:
        async for message in self.sight:
            number, _ = message.data.split()
            self.numbers.append(int(number))
            self.last = message.data


@contextlib.asynccontextmanager
async def attacked(directory: Path) -> AsyncIterator[Victim]:
    """A site with the two."""
    async with Site(directory / "site").running() as site:
        entitle(
            site,
            NAME,
            {
                Right.PUBLISH: (STATE,),
                Right.SUBSCRIBE: (COMMAND,),
                Right.PROVIDE: (SERVICE,),
                Right.PARAM_SET: (PARAMETER,),
                Right.PARAM_GET: (PARAMETER,),
            },
        )
        site.subscribe("/viewer", STATE)
        env = environment(site, directory / "logs")
        async with program(env, ROBOT) as robot, site.node("/viewer") as viewer:
            _, uri, port = (await robot.read_until("AT ")).split()
            sight = await viewer.subscriber(STATE, TYPE, queue_size=100_000)
            victim = Victim(site, robot, uri, int(port), viewer, sight, [])
            reading = asyncio.create_task(_read(robot))  # noqa: TID251 - cancelled below
            listening = asyncio.create_task(victim.listen())  # noqa: TID251 - cancelled below
            try:
                await victim.goes_on()
                yield victim
            finally:
                for task in (reading, listening):
                    task.cancel()


async def _read(running: Program) -> None:
    with contextlib.suppress(AssertionError):
        await running.read_until("\0", within=3600)


def slave_port(victim: Victim) -> int:
    return parse_uri(victim.uri)[1]


def for_service(name: str, service: str, grants: list[bytes], **changes: str) -> dict[str, Any]:
    """A client's connection header for a service."""
    fields = {"callerid": name, "service": service, "md5sum": "*", FIELD: encode(list(grants))}
    return {**fields, **changes}
