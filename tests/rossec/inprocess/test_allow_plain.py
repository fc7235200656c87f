import asyncio
import socket
import struct
import xmlrpc.client
from pathlib import Path

import pytest

from grants.model import Right
from rossec.channel.opening import REFUSAL
from rossec.errors import ConfigurationError
from rossec.host.addresses import source_for
from rossec.inprocess.options import PlainPeers
from rossec.inprocess.process import PEER_CONNECTIONS
from rossec.net.limits import HalfOpenLimits
from rossec.ros import tcpros
from rossec.ros.names import MASTER, parse_uri
from tests.support import stock
from tests.support.attacker import call, credentials
from tests.support.fleet import Program, entitle, environment, program
from tests.support.forwarded_ports import ForwardedPort, forwarded_port
from tests.support.site import Site

HERE = "127.0.0.1"


def test_only_named_entries_are_allowed() -> None:
    plain = PlainPeers(["/open", "/far@192.168.1.7", "/six@::1"])
    assert plain
    assert not PlainPeers()
    assert plain.allows("/open", "10.0.0.1")
    assert plain.allows("/far", "192.168.1.7")
    assert plain.allows("/far", "::ffff:192.168.1.7")
    assert plain.allows("/six", "::1")
    assert not plain.allows("/far", "192.168.1.8")
    assert not plain.allows("/opening", "10.0.0.1")
    assert not plain.allows("/open/door", "10.0.0.1")
    assert not plain.allows("/open", source_for("/remote/hospital/relay"))


@pytest.mark.parametrize("entry", ["", "*", "/**", "open", "/a@", "/a@robot", "/a@10.0.0.0/8"])
def test_an_invalid_entry_is_refused(entry: str) -> None:
    with pytest.raises(ConfigurationError, match="allow_plain holds"):
        PlainPeers([entry])


STOCK = """
import rospy, rospy.impl.tcpros_base
from std_msgs.msg import String
from std_srvs.srv import Trigger
rospy.init_node("plain")
words = rospy.Publisher("/plain/words", String, queue_size=1, latch=True)
words.publish("in clear")
rospy.Publisher("/plain/closed", String, queue_size=1, latch=True).publish("closed")
rospy.Service("/plain/work", Trigger, lambda request: (True, "done in clear"))
rospy.Subscriber("/robot/open", String, lambda m: print("HEARD", m.data, flush=True))
rospy.Subscriber("/robot/closed", String, lambda m: print("HEARD", m.data, flush=True))
print("AT", rospy.get_node_uri(), rospy.impl.tcpros_base.get_tcpros_server_address()[1], flush=True)
rospy.wait_for_service("/robot/ask", timeout=30)
print("CALLED", rospy.ServiceProxy("/robot/ask", Trigger)().message, flush=True)
rospy.spin()
"""

SECURED = """
import rospy, rossec
rossec.secure(allow_plain=["/plain/words", "/plain/work", "/robot/open@127.0.0.1", "/robot/ask"])
import rospy.impl.tcpros_base
from std_msgs.msg import String
from std_srvs.srv import Trigger
rospy.init_node("robot")
open_ = rospy.Publisher("/robot/open", String, queue_size=1, latch=True)
open_.publish("open to all")
closed = rospy.Publisher("/robot/closed", String, queue_size=1, latch=True)
closed.publish("secret")
rospy.Service("/robot/ask", Trigger, lambda request: (True, "answered in clear"))
print("AT", rospy.get_node_uri(), rospy.impl.tcpros_base.get_tcpros_server_address()[1], flush=True)
rospy.Subscriber("/plain/words", String, lambda m: print("HEARD", m.data, flush=True))
rospy.Subscriber("/plain/closed", String, lambda m: print("HEARD", m.data, flush=True))
rospy.wait_for_service("/plain/work", timeout=30)
print("CALLED", rospy.ServiceProxy("/plain/work", Trigger)().message, flush=True)
rospy.spin()
"""


async def register_plain(site: Site, api: str, port: int) -> None:
    """Register the plain node with the secured master, as a node with the rights would."""
    topics = ("/plain/words", "/plain/closed")
    entitle(site, "/plain", {Right.PUBLISH: topics, Right.PROVIDE: ("/plain/work",)})
    assert site.master is not None
    own = credentials(site, "/plain")
    for method, *params in (
        ("rossec.presentGrants", site.enroll("/plain").grants()),
        *(("registerPublisher", topic, "std_msgs/String", api) for topic in topics),
        ("registerService", "/plain/work", f"rosrpc://{HERE}:{port}", api),
    ):
        answer = await call(site.master.uri, own, str(method), "/plain", *params)
        assert isinstance(answer, list)
        assert answer[0] == 1, answer


async def offer_forwarded_ports(site: Site, robot: Program, own: str, api: str, port: int) -> None:
    """Behind a relay nothing is plain: not the node, and not what its relay leads to instead."""

    async def named(forwarded_port: ForwardedPort, said: str) -> None:
        answer = await call(own, boss, "publisherUpdate", MASTER, "/plain/words", [forwarded_port.uri])
        assert isinstance(answer, list)
        assert answer[0] == 1
        await robot.read_until(said)

    boss, plain_api = credentials(site, MASTER), parse_uri(api)[1]
    async with site.node("/honest") as honest:
        with (
            forwarded_port(plain_api, port) as plain,
            forwarded_port(parse_uri(honest.uri)[1], port) as lying,
        ):
            await named(plain, f"cannot call {plain.uri}: the peer is a plain")
            await named(lying, "cannot subscribe /plain/words: the peer behind a relay is a plain")


async def exhaust(api: str, port: int) -> None:
    """N8: silent and aborted connections do not count for long; the others are limited."""
    port_of_api = int(api.rstrip("/").rpartition(":")[2])
    for where in (port_of_api, port):
        for _ in range(2 * HalfOpenLimits().per_address):
            with socket.create_connection((HERE, where)) as one:
                one.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    with xmlrpc.client.ServerProxy(api) as robot_api:
        answer = await asyncio.to_thread(robot_api.requestTopic, "/x", "/robot/open", [["TCPROS"]])
    assert isinstance(answer, list)
    assert answer[0] == 1
    fields = {"topic": "/robot/open", "md5sum": "*", "type": "*"}
    callers = []
    for number in range(PEER_CONNECTIONS + 1):
        caller = socket.create_connection((HERE, port))
        caller.settimeout(20)
        caller.sendall(tcpros.encode({**fields, "callerid": f"/caller{number}"}))
        callers.append((caller, await asyncio.to_thread(caller.recv, 1 << 16)))
    for caller, _ in callers:
        caller.close()
    assert b"message_definition" in callers[0][1]
    assert f"{HERE} has {PEER_CONNECTIONS} connections already".encode() in callers[-1][1]


@pytest.mark.ros
async def test_named_entries_stay_plain_with_a_warning(tmp_path: Path) -> None:
    async with Site(tmp_path / "site").running() as site, stock.rosmaster(tmp_path) as uri:
        entitle(
            site,
            "/robot",
            {
                Right.PUBLISH: ("/robot/open", "/robot/closed"),
                Right.PROVIDE: ("/robot/ask",),
                Right.SUBSCRIBE: ("/plain/*",),
                Right.CALL: ("/plain/work",),
            },
        )
        async with (
            program(stock.environment(uri, tmp_path), STOCK) as plain,
            program(environment(site, tmp_path), SECURED) as robot,
        ):
            _, api, port = (await plain.read_until("AT")).split()
            _, own, own_port = (await robot.read_until("AT")).split()
            await register_plain(site, api, int(port))
            with xmlrpc.client.ServerProxy(uri) as master:
                for method, *params in (
                    ("registerPublisher", "/robot/open", "std_msgs/String", own),
                    ("registerPublisher", "/robot/closed", "std_msgs/String", own),
                    ("registerService", "/robot/ask", f"rosrpc://{HERE}:{own_port}", own),
                ):
                    await asyncio.to_thread(getattr(master, str(method)), "/robot", *params)
            await robot.read_until("CALLED done in clear")
            await plain.read_until("CALLED answered in clear")
            for one, words in ((robot, "HEARD in clear"), (plain, "HEARD open to all")):
                if words not in one.said:
                    await one.read_until(words)
            with xmlrpc.client.ServerProxy(own) as robot_api:
                ask = robot_api.requestTopic
                answer = await asyncio.to_thread(ask, "/x", "/robot/closed", [["TCPROS"]])
                assert answer == [-1, REFUSAL, 0]
                assert await asyncio.to_thread(robot_api.getPid, "/x") == [-1, REFUSAL, 0]
            await exhaust(own, int(own_port))
            await offer_forwarded_ports(site, robot, own, api, int(port))
            said = robot.said
    assert said.count("HEARD in clear") == 1
    assert "HEARD closed" not in said
    assert "HEARD secret" not in plain.said
    assert "rossec: PLAIN: allow_plain leaves /plain/words open to every peer" in said
    assert "rossec: PLAIN: /plain/words with 127.0.0.1, neither encrypted nor checked" in said
