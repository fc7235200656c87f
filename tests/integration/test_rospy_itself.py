"""A secured rospy program receives its own topic and calls its own service, as rospy's tests do."""

from pathlib import Path

import pytest

from grants.model import Right
from tests.support.fleet import SECURE, entitle, environment, program
from tests.support.site import Site

pytestmark = pytest.mark.ros

ITSELF = (
    SECURE
    + """
import rospy
from std_msgs.msg import String
from std_srvs.srv import Trigger
rospy.init_node("robot")
said = rospy.Publisher("/loop", String, queue_size=10, latch=True)
said.publish("to itself")
print("HEARD", rospy.wait_for_message("/loop", String, timeout=20).data, flush=True)
rospy.Service("/echo", Trigger, lambda _: (True, "said to itself"))
rospy.wait_for_service("/echo", timeout=20)
for persistent in False, True:
    proxy = rospy.ServiceProxy("/echo", Trigger, persistent=persistent)
    print("ANSWER", proxy().message, flush=True)
print("DONE", flush=True)
"""
)


async def test_a_rospy_program_reaches_itself(tmp_path: Path) -> None:
    async with Site(tmp_path / "site").running() as site:
        entitle(
            site,
            "/robot",
            {
                Right.PUBLISH: ("/loop",),
                Right.SUBSCRIBE: ("/loop",),
                Right.PROVIDE: ("/echo",),
                Right.CALL: ("/echo",),
            },
        )
        async with program(environment(site, tmp_path / "logs"), ITSELF) as robot:
            await robot.read_until("DONE")
    assert "HEARD to itself" in robot.said
    assert robot.said.count("ANSWER said to itself") == 2
    assert "Traceback" not in robot.said
