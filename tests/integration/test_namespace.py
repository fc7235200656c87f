"""Names by rules with real processes: the service, asked by rospy programs; roslaunch."""

import contextlib
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from rossec.host.callers import descendants, parents
from rossec.naming import rule_runner
from tests.integration.sidecarworld import ROSSEC, Running, World, wait
from tests.rossec.namespace.launch_texts import FIGURES
from tests.support.fleet import SECURE
from tests.support.hosts import Host, Hosts
from tests.support.messagepackage import generated
from tests.support.site import Site

pytestmark = [pytest.mark.ros, pytest.mark.timeout(240)]
PHONE = "/smartphones/schneider/htc_desire"
ACCELEROMETER = f"{PHONE}/sensors/accelerometer"
LAMP = "~output2=/n1/raum3/lamps/wallwasher"
TEMPERATURE = "/building1/room3/sensors/temperature"
SENT = (
    "<node><group>smartphones</group><owner>schneider</owner><name>htc_desire</name>"
    "<topic><name>x</name><mobile>true</mobile></topic></node>"
)
ASKS = """
import rospy, sys
from std_msgs.msg import String
from rossec_namespace.srv import GetTopicName
name, metadata = sys.argv[1:3]
rospy.init_node("phone")
rospy.wait_for_service("get_topic_name", timeout=40)
get_topic_name = rospy.ServiceProxy("get_topic_name", GetTopicName)
if metadata == "own":  # as in figure A.2
    metadata = rospy.get_param("~metadata", "")
try:
    found = get_topic_name(name, metadata)
    words = rospy.Publisher(found.topicname, String, queue_size=1, latch=True)
    words.publish("from " + name)
    print("PUBLISHES", words.resolved_name, flush=True)
    rospy.spin()
except rospy.ServiceException as error:
    print("FAILED", error, flush=True)
"""
PROGRAM = f"""#!{sys.executable}
import rospy
from std_msgs.msg import String
rospy.init_node("phone")
words = rospy.Publisher("~accelerometer", String, queue_size=1, latch=True)
words.publish("shaken")
print("READY", rospy.get_name(), flush=True)
rospy.spin()
"""


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Iterator[World]:
    directory = tmp_path_factory.mktemp("namespace")
    loopback = Host((), "127.0.0.1", "::1")
    world = World(Hosts(loopback, loopback, real=False), Site(directory / "site"), directory)
    world.enroll("/namespace", provide="/get_topic_name")
    world.enroll("/phone", call="/get_topic_name", publish=f"{PHONE}/** {TEMPERATURE}")
    world.enroll(PHONE, publish=f"{PHONE}/**", provide=f"{PHONE}/*")
    world.enroll("/rostopic", wildcard=True, subscribe="/**", graph="/**")
    world.enroll("/rosparam", wildcard=True, param_set="/phone/**")
    world.enroll(
        "/roslaunch", wildcard=True, graph="/**", param_set="/run_id /roslaunch/** /rosdistro /rosversion"
    )
    with world.master():
        yield world


@pytest.fixture(scope="module")
def service(world: World) -> Iterator[Running]:
    """`rossec namespace serve`, and the phone's metadata as its parameter."""
    example = world.directory / "phone.xml"
    example.write_bytes(rule_runner.shipped_example("phone.xml"))
    generated(world.directory)
    world.tool("rosparam", "set", "-t", str(example), "/phone/metadata")
    with world.started(world.hosts.near, ROSSEC, "namespace", "serve") as running:
        running.wait_for("/namespace provides /get_topic_name")
        yield running


@contextlib.contextmanager
def asking(world: World, form: str, *arguments: str) -> Iterator[Running]:
    """The program behind a sidecar, or in-process."""
    source = (SECURE if form == "in-process" else "") + ASKS
    path = f"PYTHONPATH={world.directory}"
    command = ("env", path, sys.executable, "-c", source, *arguments)
    start = world.started if form == "in-process" else world.secured
    with start(world.hosts.near, *command) as running:
        yield running


@pytest.mark.parametrize("form", ["sidecar", "in-process"])
@pytest.mark.parametrize(
    ("topic", "metadata", "name"),
    [
        ("accelerometer", "own", ACCELEROMETER),
        ("temperature", "", TEMPERATURE),  # the service reads the parameter
        ("x", SENT, f"{PHONE}/x"),
    ],
)
def test_a_rospy_node_publishes_where_it_is_told(
    world: World, service: Running, form: str, topic: str, metadata: str, name: str
) -> None:
    with asking(world, form, topic, metadata) as running:
        running.wait_for(f"PUBLISHES {name}\n")
        assert f'data: "from {topic}"' in world.tool("rostopic", "echo", "-n", "1", name)


@pytest.mark.parametrize("form", ["sidecar", "in-process"])
def test_a_rospy_node_is_told_why_there_is_no_name(world: World, service: Running, form: str) -> None:
    with asking(world, form, "altimeter", "own") as running:
        running.wait_for("FAILED")
        assert "no name for the topic 'altimeter'" in running.said


def named(world: World, source: Path) -> Path:
    """The transformed launch file, made by the command."""
    out = world.directory / f"{source.stem}.out.launch"
    command = (ROSSEC, "namespace", "launch", str(source), "--out", str(out))
    subprocess.run(command, check=True, capture_output=True, timeout=60)
    return out


def test_debian_s_roslaunch_reads_the_figure(world: World) -> None:
    out = named(world, FIGURES / "phones.launch")
    env = world.env(world.hosts.near)
    listed = subprocess.run(
        ("roslaunch", "--nodes", str(out)), env=env, check=True, capture_output=True, text=True, timeout=60
    )
    assert listed.stdout.split() == [PHONE, f"{PHONE}2"]
    program = (
        "import roslaunch.config, roslaunch.xmlloader, sys\n"
        "config = roslaunch.config.ROSLaunchConfig()\n"
        "roslaunch.xmlloader.XmlLoader().load(sys.argv[1], config, verbose=False)\n"
        "for node in config.nodes:\n"
        "    print(node.namespace, node.name, *sorted(map('='.join, node.remap_args)))\n"
    )
    read = subprocess.run(
        ("/usr/bin/python3", "-c", program, str(out)),
        env=env,
        check=True,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert read.stdout.splitlines() == [
        f"/smartphones/schneider/ htc_desire ~accelerometer={ACCELEROMETER} {LAMP}",
        f"/smartphones/schneider/ htc_desire2 ~accelerometer={PHONE}2/sensors/accelerometer",
    ]


def test_a_node_in_the_root_namespace_is_read_by_roslaunch(world: World) -> None:
    source, rules = world.directory / "top.launch", world.directory / "top.xsl"
    source.write_text(
        '<launch xmlns:n="urn:schemas-tum-de:vmi:ns"><group ns="deep">\n'
        '<node name="a" pkg="p" type="t"><n:group>g</n:group></node></group></launch>\n'
    )
    rules.write_text(
        '<xsl:stylesheet version="1.0" xmlns:xsl="http://www.w3.org/1999/XSL/Transform">'
        '<xsl:template match="/"><name>/top</name></xsl:template></xsl:stylesheet>'
    )
    out = world.directory / "top.out.launch"
    subprocess.run(
        (ROSSEC, "namespace", "launch", str(source), "--out", str(out), "--rules", str(rules)),
        check=True,
        capture_output=True,
        timeout=60,
    )
    listed = subprocess.run(
        ("roslaunch", "--nodes", str(out)),
        env=world.env(world.hosts.near),
        check=True,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert listed.stdout.split() == ["/top"]


def test_a_transformed_file_starts_secured(world: World) -> None:
    """Its node has the name of the rules, which is that of its certificate; so has its topic."""
    package = world.directory / "packages" / "phones"
    package.mkdir(parents=True)
    (package / "package.xml").write_text("<package><name>phones</name></package>")
    (package / "phone").write_text(PROGRAM)
    (package / "phone").chmod(0o755)
    source = world.directory / "start.launch"
    source.write_text("""<launch xmlns:ns="urn:schemas-tum-de:vmi:ns">
  <node name="htc_desire" pkg="phones" type="phone" output="screen">
    <ns:owner>schneider</ns:owner>
    <ns:group>smartphones</ns:group>
    <ns:topic type="~accelerometer">
      <ns:name>accelerometer</ns:name>
      <ns:function>sensor</ns:function>
      <ns:mobile>true</ns:mobile>
    </ns:topic>
  </node>
</launch>
""")
    out = named(world, source)
    path = f"ROS_PACKAGE_PATH={package.parent}:/usr/share"
    with world.secured(world.hosts.near, "env", path, "roslaunch", str(out)) as running:
        running.wait_for(f"READY {PHONE}")
        assert 'data: "shaken"' in world.tool("rostopic", "echo", "-n", "1", ACCELEROMETER)


def test_the_service_ends_without_a_trace(world: World, service: Running) -> None:
    """Its processes for rules end with it."""
    children = descendants(parents(), service.process.pid)
    assert children
    assert service.end() == 0
    wait(lambda: not set(children) & set(parents()))
