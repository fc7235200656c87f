"""Unmodified ROS programs of Debian on two hosts, secured from outside."""

import signal
from collections.abc import Iterator

import pytest

from tests.integration.sidecarworld import Running, World, wait
from tests.support.hosts import two_hosts
from tests.support.roscpp import compiled
from tests.support.site import Site

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
        world.enroll("/rosnode", graph="/**", admin="/talker /victim")
        world.enroll("/rosservice", wildcard=True, call="/**", graph="/**")
        world.enroll("/rosparam", wildcard=True, param_set="/talker/** /here/**")
        with world.master():
            yield world


@pytest.fixture(scope="module")
def talker(world: World, probe: str) -> Iterator[Running]:
    near = world.hosts.near
    with world.secured(near, probe, "talker", "/chatter") as running:
        yield running


def test_a_roscpp_listener_hears_a_roscpp_talker(world: World, talker: Running, probe: str) -> None:
    done = world.run(world.hosts.far, probe, "listener", "/chatter", "5")
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("HEARD hello") == 5


def test_rostopic(world: World, talker: Running) -> None:
    assert "/chatter" in world.tool("rostopic", "list")
    assert 'data: "hello' in world.tool("rostopic", "echo", "-n", "2", "/chatter")
    assert world.tool("rostopic", "type", "/chatter") == "std_msgs/String\n"
    about = world.tool("rostopic", "info", "/chatter")
    assert "/talker (http://127.0.0.1:" in about


def test_rosnode(world: World, talker: Running) -> None:
    assert "/talker" in world.tool("rosnode", "list")
    assert "xmlrpc reply from" in world.tool("rosnode", "ping", "-c", "2", "/talker")
    about = world.tool("rosnode", "info", "/talker")
    assert "Pid: " in about
    assert "/chatter [std_msgs/String]" in about


def test_rosservice(world: World, talker: Running) -> None:
    assert "/talker/say" in world.tool("rosservice", "list")
    assert world.tool("rosservice", "type", "/talker/say") == "roscpp/SetLoggerLevel\n"
    world.tool("rosservice", "call", "/talker/say", "one", "two")
    talker.wait_for("ASKED one two")


def test_parameters_arrive_while_the_program_runs(world: World, talker: Running) -> None:
    world.tool("rosparam", "set", "/talker/word", "changed")
    assert world.tool("rosparam", "get", "/talker/word") == "changed\n"
    wait(lambda: "changed" in world.tool("rostopic", "echo", "-n", "1", "/chatter"))


def test_exit_codes_and_signals_pass(world: World, probe: str) -> None:
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
