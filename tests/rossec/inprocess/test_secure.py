"""`secure`, in processes of their own: a process is secured once."""

from collections.abc import Mapping
from pathlib import Path

import pytest

from grants.model import Right
from rossec.errors import ConfigurationError
from rossec.inprocess.request import ask
from rossec.inprocess.secure import secured
from tests.support import stock
from tests.support.fleet import entitle, environment, program
from tests.support.matrix import SECRET, VARIANTS, play
from tests.support.site import Site, coarse
from tests.support.victim import attacked
from tests.support.witness import POSE, until

pytestmark = pytest.mark.ros


async def said_by(env: Mapping[str, str], source: str) -> tuple[int, str]:
    async with program(env, source) as running:
        code = await running.ends()
        return code, running.said


@pytest.fixture
def site(tmp_path: Path) -> Site:
    return Site(tmp_path / "site")


def env_of(site: Site, tmp_path: Path, **more: str) -> dict[str, str]:
    uri = "http://127.0.0.1:1"
    return {**stock.environment(uri, tmp_path), "ROSSEC_HOME": str(site.root), **more}


STOPPED = """
import sys
import rossec
def attempt(what, *arguments, **options):
    try:
        rossec.secure(*arguments, **options)
    except SystemExit as error:
        sys.stderr.write(f"{what}: {type(error.__cause__).__name__}\\n")
"""

INVALID: dict[str, tuple[str, str, dict[str, str]]] = {
    "no home": ("", "no node is enrolled in", {"ROSSEC_HOME": "/nonexistent/x"}),
    "no identity": ("'/nobody'", "/nobody has no ca.pem in", {}),
    "a bad option": ("allow_plain='/x'", "allow_plain is a list of names", {}),
    "no such file": ("", "which does not exist", {"ROSSEC_CONFIG": "/nonexistent/x"}),
}


async def test_an_invalid_setup_ends_the_program_with_a_hint(site: Site, tmp_path: Path) -> None:
    site.enroll("/robot")
    for what, (arguments, words, more) in INVALID.items():
        source = f"import rossec\nrossec.secure({arguments})\nprint('RAN')"
        code, said = await said_by(env_of(site, tmp_path, **more), source)
        assert code == 1, what
        assert said.startswith("rossec: error: "), said
        assert words in said
        assert "Traceback" not in said
        assert "RAN" not in said


async def test_late_and_repeated_calls_are_refused(site: Site, tmp_path: Path) -> None:
    site.enroll("/robot")
    (site.root / "rossec.toml").write_text("[rospy]\nallow_plain = []\n")
    source = (
        STOPPED
        + """
import rospy, rospy.core, rospy.client, rospy.topics, rospy.impl.init
import rospy.impl.tcpros_base as base
rospy.core._xmlrpc_cache["x"] = 1
attempt("connected")
rospy.core._xmlrpc_cache.clear()
rospy.client._init_node_args = ("x",)
attempt("late")
rospy.client._init_node_args = None
from std_msgs.msg import String
topic = rospy.Publisher("early", String, queue_size=1)
attempt("a topic")
topic.impl.__class__.close(topic.impl)
import rospy.impl.registration as registration
registration.get_topic_manager().topics.clear()
import rossec.inprocess.hooks as hooks
hooks.VERSIONS = ("0.1",)
attempt("version")
hooks.VERSIONS = ("1.15",)
stock = base.TCPROSTransport.write_data
base.TCPROSTransport.write_data = lambda self: None
attempt("another rospy")
base.TCPROSTransport.write_data = stock
attempt("good")
try:
    rospy.get_param("/x")
except Exception as error:
    print("NAMELESS", error)
attempt("again with other options", allow_plain=["/x"])
rossec.secure()
kept = rospy.topics.QueuedConnection
rospy.topics.QueuedConnection = None
try:
    rospy.init_node("robot")
except SystemExit:
    print("REPLACED")
rospy.topics.QueuedConnection = kept
try:
    rospy.init_node("stranger")
except SystemExit as error:
    print("STOPPED", error.__cause__)
import os
os._exit(0)
"""
    )
    env = env_of(site, tmp_path, PYTHONUNBUFFERED="1")
    _, said = await said_by(env, source)
    for word in ("connected", "late", "a topic", "version", "another rospy"):
        assert f"{word}: ConfigurationError" in said, said
    assert "again with other options: ConfigurationError" in said
    assert "good:" not in said
    assert "NAMELESS this program has no name yet" in said
    assert "REPLACED" in said
    assert "STOPPED /stranger has no ca.pem" in said


async def test_a_process_that_catches_the_exit_starts_no_node(site: Site, tmp_path: Path) -> None:
    """As a notebook does, or a thread; a later attempt may succeed."""
    site.enroll("/robot")
    source = """
import rossec, rospy, os
def attempt(function, *arguments):
    try:
        function(*arguments)
        print("DONE", function.__name__, flush=True)
    except SystemExit:
        pass
home = os.environ["ROSSEC_HOME"]
os.environ["ROSSEC_HOME"] = "/nonexistent/x"
attempt(rossec.secure)
attempt(rospy.init_node, "robot")
attempt(rospy.init_node, "robot")
os.environ["ROSSEC_HOME"] = home
attempt(rossec.secure)
attempt(rospy.init_node, "stranger")
"""
    env = env_of(site, tmp_path, PYTHONUNBUFFERED="1")
    _, said = await said_by(env, source)
    assert said.count("rossec: error: no node is enrolled in /nonexistent/x\n") == 3, said
    assert said.count("DONE secure") == 1
    assert "DONE init_node" not in said
    assert "rossec: error: /stranger has no ca.pem" in said


async def test_two_names_for_one_program_are_refused(site: Site, tmp_path: Path) -> None:
    site.enroll("/robot")
    source = "import rossec, rospy\nrossec.secure('/robot')\nrospy.init_node('other')"
    code, said = await said_by(env_of(site, tmp_path), source)
    assert code == 1
    assert "this program is secured as /robot, but rospy.init_node names it /other" in said


def test_calls_that_need_a_secured_program_raise() -> None:
    with pytest.raises(ConfigurationError, match="not secured"):
        secured()
    with pytest.raises(ConfigurationError, match="not secured"):
        ask("subscribe", "/x", why="y")


async def test_a_program_that_uses_all_of_rospy_works(tmp_path: Path) -> None:
    async with Site(tmp_path / "site").running() as site:
        lines = await play(site, tmp_path / "logs", VARIANTS["namespaced"])
    assert f"SEEN latched {SECRET} latched" in lines
    assert "SEEN ordered True" in lines


FILTERING = """
import rospy, rossec
rossec.secure()
from geometry_msgs.msg import PoseStamped
rospy.init_node("robot")
poses = rospy.Publisher("/robot/pose", PoseStamped, queue_size=100, latch=True)
now = rospy.Publisher("/robot/now", PoseStamped)
pose = PoseStamped()
pose.pose.position.x, pose.header.frame_id = 3.3, "map"
while not rospy.is_shutdown():
    pose.header.frame_id = "map" if pose.header.frame_id == "elsewhere" else "elsewhere"
    poses.publish(pose)
    now.publish(pose)
    rospy.sleep(0.005)
"""


@pytest.mark.parametrize("topic", ["/robot/pose", "/robot/now"])
async def test_each_subscriber_receives_what_its_grant_allows(tmp_path: Path, topic: str) -> None:
    async with Site(tmp_path / "site").running() as site:
        entitle(site, "/robot", {Right.PUBLISH: (topic,)})
        site.subscribe("/near", topic)
        site.subscribe("/far", topic, coarse())
        async with (
            program(environment(site, tmp_path), FILTERING),
            site.node("/near") as near,
            site.node("/far") as far,
        ):
            exact = await near.subscriber(topic, POSE)
            rounded = await far.subscriber(topic, POSE)
            exact_one = await anext(aiter(exact))
            rounded_one = await anext(aiter(rounded))
            await until(lambda: rounded.received > 3)
    assert exact_one.pose.position.x == 3.3
    assert (rounded_one.pose.position.x, rounded_one.header.frame_id) == (4.0, "")


TOOLS = """
import rosgraph.impl.graph, rosnode, rospy, rosservice, rossec, xmlrpc.client
rossec.secure()
rospy.init_node("operator")
print("PING", rosnode.rosnode_ping("/robot", max_count=1), flush=True)
rosnode.rosnode_info("/robot")
print("TYPE", rosservice.get_service_type("/robot/reset"), flush=True)
graph = rosgraph.impl.graph.Graph()
graph.update()
print("BAD", graph.bad_nodes, flush=True)
try:
    rospy.set_param("/operator/much", 2**40)
except OverflowError as error:
    print("NO", error, flush=True)
try:
    rospy.set_param("/operator/text", "a\\0b")
except xmlrpc.client.Fault as fault:
    print("FAULT", fault.faultCode, flush=True)
print(f"KILLED {rosnode.kill_nodes(['/robot'])}", flush=True)
"""


async def test_the_ros_tools_work_in_a_secured_program(tmp_path: Path) -> None:
    """They connect to nodes by themselves; their calls need rights of their own."""
    async with attacked(tmp_path) as victim:
        site = victim.site
        for right in (Right.GRAPH, Right.ADMIN):
            site.grant("/operator", right, "/robot")
        site.grant("/operator", Right.GRAPH, "/**")
        site.grant("/operator", Right.CALL, "/robot/reset")
        async with program(environment(site, tmp_path / "o"), TOOLS) as operator:
            await operator.read_until("PING True")
            await operator.read_until(f"Pid: {victim.program.process.pid}")
            await operator.read_until("TYPE std_srvs/Trigger")
            await operator.read_until("BAD {}")
            await operator.read_until("NO int exceeds XML-RPC limits")
            await operator.read_until("FAULT 1")
            await operator.read_until("KILLED (['/robot'], [])")
        await until(lambda: "ENDED" in victim.said)
