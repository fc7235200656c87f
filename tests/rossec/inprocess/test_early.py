"""What stock rospy allows before `rospy.init_node`, and proxies that a program makes itself."""

from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from grants.model import Right
from tests.support.fleet import Program, entitle, environment, program
from tests.support.site import Site

pytestmark = pytest.mark.ros

EARLY = """
import sys
import rospy, rosgraph, rosparam, rosservice
import rossec
rossec.secure(%s)
from std_srvs.srv import Trigger, TriggerResponse
rospy.set_param("speed", 7)
print("SET", rospy.get_param("/ns/speed"), rospy.has_param("speed"), flush=True)
print("FOUND", rospy.search_param("speed"), flush=True)
print("LIST", rosparam.list_params("/ns"), flush=True)
print("MASTER", rosgraph.Master("/script").lookupService("/helper/go"), flush=True)
rospy.wait_for_service("/helper/go", timeout=20)
print("SAID", rospy.ServiceProxy("/helper/go", Trigger)().message, flush=True)
print("TYPE", rosservice.get_service_type("/helper/go"), flush=True)
rospy.init_node(%s)
print("NAMED", rospy.get_name(), rospy.get_param("speed"), flush=True)
rospy.Service("~own", Trigger, lambda _: TriggerResponse(True, "me"))
print("OWN", rospy.ServiceProxy("~own", Trigger)().message, flush=True)
rospy.delete_param("speed")
"""
HELPER = """
import rossec, rospy
rossec.secure()
from std_srvs.srv import Trigger, TriggerResponse
rospy.init_node("helper")
rospy.Service("/helper/go", Trigger, lambda _: TriggerResponse(True, "helped"))
print("READY", flush=True)
rospy.spin()
"""
WAYS: dict[str, tuple[str, str, tuple[str, ...], dict[str, str]]] = {
    "argument": ("'robot'", "'robot'", (), {"ROS_NAMESPACE": "/ns"}),
    "absolute argument": ("'/ns/robot'", "'robot'", ("__ns:=ns",), {}),
    "roslaunch": ("", "'x'", ("__name:=robot",), {"ROS_NAMESPACE": "ns"}),
    "renamed": ("'x'", "'x'", ("__name:=robot", "__ns:=/ns"), {}),
    "variable": ("", "'robot'", (), {"ROS_NAMESPACE": "/ns", "ROSSEC_NODE": "robot"}),
}


@pytest.fixture
async def site(tmp_path: Path) -> AsyncIterator[Site]:
    async with Site(tmp_path / "site").running() as site:
        entitle(site, "/helper", {Right.PROVIDE: ("/helper/*",)})
        entitle(
            site,
            "/ns/robot",
            {
                Right.CALL: ("/helper/go", "/ns/robot/own"),
                Right.PROVIDE: ("/ns/robot/*",),
                Right.PARAM_GET: ("/**",),
                Right.PARAM_SET: ("/ns/*",),
            },
        )
        yield site


@pytest.mark.parametrize("way", WAYS)
async def test_a_node_works_before_it_is_initialized(site: Site, tmp_path: Path, way: str) -> None:
    given, named, arguments, more = WAYS[way]
    source = EARLY % (given, named)
    async with program(environment(site, tmp_path / "h"), HELPER) as helper:
        await helper.read_until("READY")
        env = environment(site, tmp_path / "r", **more)
        async with program(env, source, *arguments) as robot:
            await says(
                robot,
                "SET 7 True",
                "FOUND /ns/speed",
                "LIST ['/ns/speed']",
                "MASTER rosrpc://",
                "SAID helped",
                "TYPE std_srvs/Trigger",
                "NAMED /ns/robot 7",
                "OWN me",
            )


async def says(running: Program, *lines: str) -> None:
    for line in lines:
        assert (await running.read_until(line.split()[0])).startswith(line)


NAMELESS = """
import rospy, rosgraph, xmlrpc.client
import rossec
rossec.secure()
from std_srvs.srv import Trigger
def attempt(what, function, *arguments):
    try:
        function(*arguments)
    except Exception as error:
        print(what, type(error).__name__, error, *error.__notes__, flush=True)
attempt("GET", rospy.get_param, "/x")
attempt("SET", rospy.set_param, "/x", 1)
attempt("WAIT", rospy.wait_for_service, "/x")
attempt("CALL", rospy.ServiceProxy("/x", Trigger))
attempt("PROXY", xmlrpc.client.ServerProxy(rosgraph.get_master_uri()).getPid, "/x")
attempt("MASTER", rosgraph.Master("/x").getPid)
print("DONE", flush=True)
"""


async def test_a_call_without_a_name_raises_with_a_hint(site: Site, tmp_path: Path) -> None:
    """In stock rospy, `wait_for_service` would wait without end."""
    said = (
        "ConfigurationError this program has no name yet hint: call rospy.init_node first, or give"
        " the name it will have: rossec.secure('name'), or __name:=name on the command line"
    )
    async with program(environment(site, tmp_path), NAMELESS) as nameless:
        for what in ("GET", "SET", "WAIT", "CALL", "PROXY", "MASTER"):
            assert await nameless.read_until(what) == f"{what} {said}"
        await nameless.read_until("DONE")


ANOTHER = """
import rospy, rossec
rossec.secure("robot")
rospy.get_param("/x", 1)
rospy.init_node("other")
"""


async def test_a_name_given_early_must_be_the_nodes(site: Site, tmp_path: Path) -> None:
    entitle(site, "/robot", {})
    async with program(environment(site, tmp_path), ANOTHER) as other:
        assert await other.ends() == 1
        assert "is secured as /robot, but rospy.init_node names it /other" in other.said


PROXIES = """
import rospy, rosgraph
from xmlrpc.client import MultiCall, ServerProxy
import rossec
rossec.secure()
from std_msgs.msg import String
rospy.init_node("operator")
rospy.Subscriber("/word", String, lambda _: None)
master = ServerProxy(rosgraph.get_master_uri())
print("STATE", "/word" in dict(master.getSystemState("/script")[2][1]), flush=True)
print("FOUND", master.searchParam("/deep/script", "speed")[2], flush=True)
print("MET", master.getParam("/deep/script", "speed"), flush=True)
print("NOBODY", master.getPid(), flush=True)
many = MultiCall(master)
many.getParam("/deep/script", "speed")
many.getParam("/script", "speed")
print("MANY", [answer[2] for answer in many()], flush=True)
code, _, uri = master.lookupNode("/script", "/helper")
print("ASKED", ServerProxy(uri).getPid("/script")[0], flush=True)
print("ITSELF", ServerProxy(rospy.get_node_uri()).getPid("/script")[0], flush=True)
for odd in ("https://127.0.0.1:1/", "http://127.0.0.1/"):
    try:
        ServerProxy(odd).getPid("/script")
    except Exception as error:
        print("ELSEWHERE", isinstance(error, OSError), flush=True)
"""


async def test_proxies_that_a_program_makes_itself(site: Site, tmp_path: Path) -> None:
    """As rostest does; the library's class is the same wherever it was imported."""
    entitle(
        site,
        "/operator",
        {
            Right.SUBSCRIBE: ("/word",),
            Right.GRAPH: ("/helper", "/operator"),
            Right.PARAM_GET: ("/**",),
            Right.PARAM_SET: ("/**",),
        },
    )
    source = PROXIES.replace(
        "master =", 'rospy.set_param("/speed", 1)\nrospy.set_param("/deep/speed", 2)\nmaster ='
    )
    async with program(environment(site, tmp_path / "h"), HELPER) as helper:
        await helper.read_until("READY")
        async with program(environment(site, tmp_path / "o"), source) as operator:
            await says(
                operator,
                "STATE True",
                "FOUND /deep/speed",
                "MET [1, 'Parameter [/deep/speed]'",
                "NOBODY [-1, 'missing required caller_id parameter', -1]",
                "MANY [2, 1]",
                "ASKED 1",
                "ITSELF 1",
                "ELSEWHERE True",
                "ELSEWHERE True",
            )


ABROAD = """
import rospy
import rossec
rossec.secure()
rospy.init_node("operator")
rospy.set_param("/remote/other/speed", 1)
rospy.spin()
"""


async def test_what_is_offered_below_remote_is_refused_and_said(site: Site, tmp_path: Path) -> None:
    """rospy.set_param ignores the answer."""
    entitle(site, "/operator", {Right.PARAM_SET: ("/**",)})
    async with program(environment(site, tmp_path), ABROAD) as operator:
        await operator.read_until("setParam: /remote/other/speed cannot be set here")


OTHERS = """
import threading, rospy, rossec
from xmlrpc.client import ServerProxy
from xmlrpc.server import SimpleXMLRPCServer
rossec.secure()
server = SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False)
server.register_function(lambda: "plain", "what")
threading.Thread(target=server.serve_forever, daemon=True).start()
print("HEARD", ServerProxy("http://127.0.0.1:%d/" % server.server_address[1]).what(), flush=True)
server.shutdown()
"""


async def test_a_server_outside_ros_is_called_unsecured(site: Site, tmp_path: Path) -> None:
    async with program(environment(site, tmp_path), OTHERS) as other:
        await other.read_until("HEARD plain")
