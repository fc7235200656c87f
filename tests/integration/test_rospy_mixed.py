"""Secured and stock programs that connect to each other: each logs the reason of the failure."""

import asyncio
import xmlrpc.client
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
import pytest_asyncio

from grants.model import Right
from rossec.channel.opening import REFUSAL
from tests.integration.test_stock_ros import false_slave
from tests.support import stock
from tests.support.attacker import call, credentials
from tests.support.fleet import SECURE, entitle, environment, program
from tests.support.site import Site
from tests.support.victim import SERVICE, STATE, TYPE, Victim, attacked

pytestmark = [pytest.mark.ros, pytest.mark.asyncio(loop_scope="module")]

PLAIN_NODE = """
import rospy, rospy.impl.tcpros_base
from std_msgs.msg import String
from std_srvs.srv import Trigger
rospy.init_node("plain")
rospy.Publisher("/plain/words", String, queue_size=1, latch=True).publish("in clear")
rospy.Service("/plain/work", Trigger, lambda request: (True, "in clear"))
print("AT", rospy.get_node_uri(), rospy.impl.tcpros_base.get_tcpros_server_address()[1], flush=True)
rospy.spin()
"""

SECURED_CLIENT = (
    SECURE
    + """
import rospy
from std_msgs.msg import String
from std_srvs.srv import Trigger
rospy.init_node("client")
rospy.Subscriber("/plain/words", String, lambda message: print("HEARD", message, flush=True))
try:
    rospy.ServiceProxy("/plain/work", Trigger)()
except rospy.ServiceException as error:
    print(f"FAILED {error}", flush=True)
try:
    rospy.wait_for_service("/plain/work", timeout=1)
except rospy.ROSException as error:
    print(f"WAITED {error}", flush=True)
rospy.spin()
"""
)

STOCK_CLIENT = """
import rospy
from std_srvs.srv import Trigger
try:
    rospy.ServiceProxy("/robot/reset", Trigger)()
except rospy.ServiceException as error:
    print(f"FAILED {error}", flush=True)
"""

SECURED_LOST = (
    SECURE
    + """
import rospy
try:
    rospy.get_param("/anything")
except Exception as error:
    print(f"FAILED {error}", flush=True)
rospy.init_node("client")
"""
)

STOCK_NODE = """
import rospy
from std_srvs.srv import Trigger
rospy.init_node("stock_node")
rospy.Service("/stock/service", Trigger, lambda request: (True, ""))
rospy.signal_shutdown("done")
"""


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def victim(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Victim]:
    async with attacked(tmp_path_factory.mktemp("victim")) as victim:
        yield victim


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def plain(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[tuple[str, str, int]]:
    """A stock master and a stock node: the master's URI, the node's, its TCPROS port."""
    directory: Path = tmp_path_factory.mktemp("plain")
    async with (
        stock.rosmaster(directory) as uri,
        program(stock.environment(uri, directory), PLAIN_NODE) as node,
    ):
        _, api, port = (await node.read_until("AT ")).split()
        yield uri, api, int(port)


async def introduce(site: Site, api: str, port: int) -> None:
    """Register the plain node with the secured master, as an authorized node could."""
    entitle(site, "/plain", {Right.PUBLISH: ("/plain/words",), Right.PROVIDE: ("/plain/work",)})
    assert site.master is not None
    own = credentials(site, "/plain")
    for method, *params in (
        ("rossec.presentGrants", site.enroll("/plain").grants()),
        ("registerPublisher", "/plain/words", TYPE, api),
        ("registerService", "/plain/work", f"rosrpc://127.0.0.1:{port}", api),
    ):
        answer = await call(site.master.uri, own, str(method), "/plain", *params)
        assert isinstance(answer, list)
        assert answer[0] == 1, answer


async def test_a_secured_program_reports_a_plain_peer(
    victim: Victim, plain: tuple[str, str, int], tmp_path: Path
) -> None:
    _, api, port = plain
    site = victim.site
    entitle(site, "/client", {Right.SUBSCRIBE: ("/plain/words",), Right.CALL: ("/plain/work",)})
    await introduce(site, api, port)
    async with program(environment(site, tmp_path), SECURED_CLIENT) as client:
        await client.read_until("WAITED")
        said = client.said
    is_plain = "the peer is a plain ROS node and says: no topic or service name detected"
    assert "FAILED unable to connect to service: rossec: " + is_plain in said
    assert "WAITED timeout exceeded while waiting for service /plain/work" in said
    topic = f"[WARN] rossec: cannot call {api}: the peer is a plain HTTP server and says: "
    assert topic in without_time(said)
    assert f"[WARN] rossec: cannot connect to 127.0.0.1 port {port}: {is_plain}" in without_time(said)
    assert "(hint: the peer is a plain ROS node: give it an identity" in said
    assert "HEARD" not in said
    assert said.count("cannot connect to") == 1, "once, not for each try"


def without_time(said: str) -> str:
    return "\n".join(
        line[: line.find("]") + 1] + line[line.find("]:") + 2 :] if "]:" in line else line
        for line in said.splitlines()
    )


async def test_a_stock_subscriber_gets_the_reason(victim: Victim, tmp_path: Path) -> None:
    async with stock.rosmaster(tmp_path) as uri:
        with false_slave(victim.port) as slave:
            with xmlrpc.client.ServerProxy(uri) as master:
                await asyncio.to_thread(master.registerPublisher, "/x", STATE, TYPE, slave)
            env = stock.environment(uri, tmp_path)
            listener = stock.LISTENER.replace("geometry_msgs", "std_msgs")
            source = listener.replace("PoseStamped", "String")
            async with stock.process(env, *stock.python(source, STATE)):
                line = await stock.logged(tmp_path, "rossec: ")
                assert "remote error reported: " + REFUSAL in line
    await victim.goes_on()


async def test_a_stock_caller_of_the_api_gets_the_reason(victim: Victim) -> None:
    with xmlrpc.client.ServerProxy(victim.uri) as robot:
        for method, *params in (("requestTopic", STATE, [["TCPROS"]]), ("shutdown", "x")):
            answer = await asyncio.to_thread(getattr(robot, str(method)), "/x", *params)
            assert answer == [-1, REFUSAL, 0]
    await victim.goes_on()


async def test_a_stock_client_of_a_service_gets_the_reason(victim: Victim, tmp_path: Path) -> None:
    async with stock.rosmaster(tmp_path) as uri:
        with xmlrpc.client.ServerProxy(uri) as master:
            where = f"rosrpc://127.0.0.1:{victim.port}"
            await asyncio.to_thread(master.registerService, "/robot", SERVICE, where, victim.uri)
        _, said = await stock.run(stock.environment(uri, tmp_path), *stock.python(STOCK_CLIENT))
    assert f"FAILED unable to connect to service: remote error reported: {REFUSAL}" in said
    await victim.goes_on()


async def test_stock_parameters_and_services_are_refused_by_a_secured_master(
    victim: Victim, tmp_path: Path
) -> None:
    assert victim.site.master is not None
    env = stock.environment(victim.site.master.uri, tmp_path)
    _, said = await stock.run(env, *stock.python(STOCK_NODE))
    assert f"unable to register service [/stock/service] with master: {REFUSAL}" in said
    code, said = await stock.run(env, str(stock.TOOLS / "rosparam"), "get", "/robot/speed")
    assert code != 0
    assert REFUSAL in said


async def test_a_secured_program_reports_a_plain_master(
    victim: Victim, plain: tuple[str, str, int], tmp_path: Path
) -> None:
    env = environment(victim.site, tmp_path, ROS_MASTER_URI=plain[0], ROSSEC_NODE="/client")
    victim.site.enroll("/client")
    async with program(env, SECURED_LOST) as lost:
        line = await lost.read_until("no answer from the master")
        assert "the peer is a plain HTTP server and says: HTTP/1.1 501" in line
        failed = await lost.read_until("FAILED")
        assert "rossec: " in failed
