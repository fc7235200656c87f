"""Unmodified ROS programs of Debian on two hosts, secured from outside."""

import asyncio
import re
import signal
from collections.abc import Iterator
from dataclasses import replace

import pytest

from rossec.channel.opening import WireProtocol, first_bytes
from tests.integration.sidecarworld import ROSSEC, Running, World, wait
from tests.support.hosts import two_hosts
from tests.support.recorder import Recording
from tests.support.roscpp import compiled
from tests.support.site import Site

RELAY = "/usr/lib/topic_tools/relay"

pytestmark = [pytest.mark.ros, pytest.mark.timeout(240)]


@pytest.fixture(scope="module")
def probe(request: pytest.FixtureRequest) -> str:
    return str(compiled(request.config.cache.mkdir("roscpp")))


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Iterator[World]:
    directory = tmp_path_factory.mktemp("sidecar")
    site = Site(directory / "site")
    with two_hosts() as hosts:
        world = World(hosts, site, directory)
        world.enroll("/talker", publish="/chatter", provide="/talker/say")
        world.enroll("/listener", subscribe="/chatter", provide="/listener/say")
        world.enroll("/rostopic", wildcard=True, subscribe="/**", publish="/far", graph="/**")
        world.enroll("/rosnode", graph="/**", admin="/victim")
        world.enroll("/rosservice", wildcard=True, call="/**", graph="/**")
        world.enroll("/rosparam", wildcard=True, param_set="/talker/** /here/**")
        with world.master():
            yield world


@pytest.fixture(scope="module")
def talker(world: World, probe: str) -> Iterator[Running]:
    near = world.hosts.near
    with world.secured(near, probe, "talker", "/chatter") as running:
        yield running


def test_a_roscpp_listener_receives_a_roscpp_talker(world: World, talker: Running, probe: str) -> None:
    done = world.run(world.hosts.far, probe, "listener", "/chatter", "5")
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("HEARD hello") == 5


def test_a_roscpp_node_finds_parameters_upwards(world: World, probe: str) -> None:
    """`searchParam` names the namespace of its node as the caller: robot_state_publisher ended."""
    world.tool("rosparam", "set", "/here/lamp", "1")
    for name, found in (("/here/searcher", "FOUND /here/lamp\n"), ("/searcher", "")):
        world.enroll(name)
        space = name.removesuffix("searcher")
        done = world.run(world.hosts.near, probe, "searcher", "lamp", f"__ns:={space}")
        assert done.stdout == found, done.stderr


def test_rostopic_works(world: World, talker: Running) -> None:
    assert "/chatter" in world.tool("rostopic", "list")
    assert 'data: "hello' in world.tool("rostopic", "echo", "-n", "2", "/chatter")
    assert world.tool("rostopic", "type", "/chatter") == "std_msgs/String\n"
    about = world.tool("rostopic", "info", "/chatter")
    assert "/talker (http://127.0.0.1:" in about


def test_rosnode_works(world: World, talker: Running) -> None:
    assert "/talker" in world.tool("rosnode", "list")
    assert "xmlrpc reply from" in world.tool("rosnode", "ping", "-c", "2", "/talker")
    about = world.tool("rosnode", "info", "/talker")
    assert "Pid: " in about
    assert "/chatter [std_msgs/String]" in about


def test_an_anonymous_node_provides_the_services_of_its_own_name(world: World, talker: Running) -> None:
    """Its grant says `/rostopic~/get_loggers`: the name is known when it starts."""
    with world.secured(world.hosts.far, "rostopic", "echo", "/chatter") as echo:
        echo.wait_for("data:")
        listed = world.tool("rosservice", "list")
        (own,) = re.findall(r"^/rostopic_\w+/get_loggers$", listed, re.MULTILINE)
        assert "loggers" in world.tool("rosservice", "call", own)
        level = own.replace("get_loggers", "set_logger_level")
        world.tool("rosservice", "call", level, "rosout", "warn")
        echo.end(signal.SIGINT)
    assert own.rpartition("/")[0] not in world.tool("rosnode", "list")


def test_rosservice_works(world: World, talker: Running) -> None:
    assert "/talker/say" in world.tool("rosservice", "list")
    assert world.tool("rosservice", "type", "/talker/say") == "roscpp/SetLoggerLevel\n"
    world.tool("rosservice", "call", "/talker/say", "one", "two")
    talker.wait_for("ASKED one two")


def test_parameters_arrive_while_the_program_runs(world: World, talker: Running) -> None:
    world.tool("rosparam", "set", "/talker/word", "changed")
    assert world.tool("rosparam", "get", "/talker/word") == "changed\n"
    wait(lambda: "changed" in world.tool("rostopic", "echo", "-n", "1", "/chatter"))


def test_exit_codes_and_signals_are_passed_on(world: World, probe: str) -> None:
    near = world.hosts.near
    assert world.run(near, "sh", "-c", "exit 7").returncode == 7
    assert world.run(near, "sh", "-c", "kill -KILL $$").returncode == 128 + 9
    missing = world.run(near, "/no/such/program")
    assert missing.returncode == 127
    assert missing.stderr.startswith("rossec: error: /no/such/program: there is no such program")
    trap = "trap 'echo caught; exit 5' USR1; echo ready; while :; do sleep 0.1; done"
    with world.secured(near, "sh", "-c", trap) as running:
        running.wait_for("ready")
        assert running.end(signal.SIGUSR1) == 5
        assert "caught" in running.said


def test_rosnode_kill_and_cleanup_need_the_right_to_administer(world: World, probe: str) -> None:
    """A node is stopped only by a peer with the right to; a dead one is cleaned up."""
    victim = (probe, "talker", "/victim/topic", "__name:=victim")
    world.enroll("/victim", publish="/victim/topic", provide="/victim/say")
    world.enroll("/meddler", graph="/**")
    near, far = world.hosts.near, world.hosts.far
    with world.secured(near, *victim) as running:
        wait(lambda: "/victim" in world.tool("rosnode", "list"))
        world.run(far, "rosnode", "kill", "/victim", options=("--as", "/meddler"))
        assert running.process.poll() is None
        assert "killed" in world.tool("rosnode", "kill", "/victim")
        assert running.process.wait(20) == 0
    with world.secured(near, *victim) as running:
        wait(lambda: "/victim" in world.tool("rosnode", "list"))
        running.close()
    assert "/victim" in world.tool("rosnode", "list")
    done = world.run(far, "rosnode", "ping", "-c", "2", "/victim")
    assert "connection refused" in done.stdout + done.stderr
    asked = world.tool("sh", "-c", "yes | rosnode cleanup", options=("--as", "/rosnode"))
    assert "Unregistering /victim" in asked
    assert "/victim" not in world.tool("rosnode", "list")


def test_a_bag_is_recorded_and_played(world: World, talker: Running, probe: str) -> None:
    """Anonymous rosbag nodes on the second host; the first one receives what is played there."""
    world.enroll("/record", wildcard=True, subscribe="/chatter")
    world.enroll("/play", wildcard=True, publish="/replayed /clock")
    world.enroll("/hearer", subscribe="/replayed", provide="/hearer/say")
    bag = world.directory / "chatter.bag"
    world.tool("rosbag", "record", "-l", "8", "-O", str(bag), "/chatter")
    near, far = world.hosts.near, world.hosts.far
    with (
        world.secured(near, probe, "listener", "/replayed", "3", "__name:=hearer") as hearer,
        world.secured(far, "rosbag", "play", "-l", str(bag), "/chatter:=/replayed"),
    ):
        hearer.wait_for("HEARD")
        assert hearer.process.wait(20) == 0


def test_relay_rostopic_pub_and_hz_work(world: World, talker: Running) -> None:
    world.enroll("/chatter_relay", wildcard=True, subscribe="/chatter", publish="/far")
    far, near = world.hosts.far, world.hosts.near
    with world.secured(far, RELAY, "/chatter", "/far"):
        done = world.run(near, "rostopic", "echo", "-n", "2", "/far")
        assert done.returncode == 0, done.stderr
        assert done.stdout.count("data: ") == 2
        with world.secured(near, "rostopic", "hz", "-w", "5", "/far") as meter:
            meter.wait_for("average rate: ")
    with world.secured(far, "rostopic", "pub", "-r", "10", "/far", "std_msgs/String", "one"):
        done = world.run(near, "rostopic", "echo", "-n", "1", "/far")
        assert 'data: "one"' in done.stdout


def test_a_node_receives_its_own_topic_directly(world: World, probe: str) -> None:
    world.enroll("/both", publish="/loop", subscribe="/loop", provide="/both/say")
    done = world.run(world.hosts.far, probe, "both", "/loop", "3", "__name:=both")
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("HEARD hello") == 3


def test_rosout_and_roslaunch_work_with_four_nodes(world: World, probe: str) -> None:
    """Each node of the launch file uses its own identity; /rosout receives from all of them."""
    world.enroll("/rosout", subscribe="/rosout", publish="/rosout_agg")
    world.enroll(
        "/roslaunch",
        wildcard=True,
        graph="/**",
        param_set="/run_id /roslaunch/** /rosdistro /rosversion /one/** /two/** /three/**",
    )
    world.enroll("/one", publish="/a", provide="/one/say")
    world.enroll("/two", publish="/b", provide="/two/say")
    world.enroll("/four", publish="/d", subscribe="/d", provide="/four/say")
    world.enroll("/three", subscribe="/a", provide="/three/say")
    launch = world.directory / "four.launch"
    command = f'launch-prefix="{ROSSEC} run --as /three --"'
    launch.write_text(f"""<launch>
  <node pkg="probe" type="probe" name="one" args="talker /a">
    <param name="word" value="launched"/>
  </node>
  <node pkg="probe" type="probe" name="two" args="talker /b"/>
  <node pkg="probe" type="probe" name="three" args="listener /a" output="screen" {command}/>
  <node pkg="probe" type="probe" name="four" args="both /d 2"/>
</launch>""")
    package = world.directory / "packages" / "probe"
    package.mkdir(parents=True)
    (package / "package.xml").write_text("<package><name>probe</name></package>")
    (package / "probe").symlink_to(probe)
    path = f"ROS_PACKAGE_PATH={package.parent}:/usr/share"
    far = world.hosts.far
    with (
        world.secured(far, "/usr/lib/rosout/rosout"),
        world.secured(far, "env", path, "roslaunch", str(launch)) as running,
    ):
        running.wait_for("HEARD launched")
        running.wait_for("[four-4] process has finished cleanly")
        assert {"/one", "/two", "/three", "/rosout"} <= set(world.tool("rosnode", "list").split())
        assert 'msg: "still here"' in world.tool("rostopic", "echo", "-n", "1", "/rosout_agg")
        running.end(signal.SIGINT)


def test_only_ciphertext_crosses_the_link(world: World, talker: Running, probe: str) -> None:
    if not world.hosts.real:
        pytest.skip("NOT RUN: network namespaces are not permitted here")

    async def capture() -> Recording:
        async with world.hosts.recorded(world.directory / "link.pcap") as recordings:
            await asyncio.to_thread(world.run, world.hosts.far, probe, "listener", "/chatter", "20")
        return recordings[0]

    recording = asyncio.run(capture())
    assert recording.dropped == 0
    assert sum(map(len, recording.flows.values())) > 5000
    for secret in (
        b"chatter",
        b"hello",
        b"talker",
        b"listener",
        b"std_msgs",
        b"methodCall",
        b"callerid",
        b"rossec_grants",
        b"registerSubscriber",
    ):
        assert not recording.holds(secret), secret
    openings = tuple(map(first_bytes, WireProtocol))
    callers = {flow for flow, data in recording.flows.items() if data.startswith(openings)}
    answers = {flow[2:] + flow[:2] for flow in callers}
    assert len(callers) >= 3
    assert recording.flows.keys() <= callers | answers


def test_a_listener_receives_a_talker_over_ipv6(world: World, probe: str) -> None:
    if not world.hosts.real:
        pytest.skip("NOT RUN: network namespaces are not permitted here")
    six = replace(world, port=11366, ipv6=True, home=world.directory / "six")
    world.enroll("/six", publish="/six", provide="/six/say")
    world.enroll("/six_ear", subscribe="/six", provide="/six_ear/say")
    with six.master(), six.secured(six.hosts.near, probe, "talker", "/six", "__name:=six"):
        done = six.run(six.hosts.far, probe, "listener", "/six", "3", "__name:=six_ear")
        assert done.returncode == 0, done.stdout + done.stderr
        six.tool("rosservice", "call", "/six/say", "one", "six")
