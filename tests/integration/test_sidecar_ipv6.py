"""Debian's programs behind sidecars on hosts that have IPv6 alone, loopback included."""

import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.integration.sidecarworld import Running, World, wait
from tests.support.hosts import Host, Hosts, two_hosts
from tests.support.roscpp import compiled
from tests.support.site import Site

NAMES = "::1 localhost ip6-localhost ip6-loopback\n"  # as in Debian's /etc/hosts, without 127.0.0.1

pytestmark = [pytest.mark.ros, pytest.mark.timeout(240)]


@dataclass(frozen=True)
class Bare(Host):
    """A host with its own hosts file."""

    names: Path

    def at(self, *command: str) -> tuple[str, ...]:
        mounted = f'mount --bind "{self.names}" /etc/hosts && exec "$@"'
        return super().at("unshare", "--mount", "sh", "-c", mounted, "sh", *command)


def bared(host: Host, names: Path) -> Host:
    """The host, after all of its IPv4 was taken away."""
    subprocess.run(host.at("ip", "-4", "addr", "flush", "dev", "lo"), check=True)
    subprocess.run(host.at("ip", "-4", "addr", "flush", "dev", "rossec0"), check=True)
    return Bare(host.prefix, host.ipv4, host.ipv6, names)


@pytest.fixture(scope="module")
def programs(request: pytest.FixtureRequest) -> Path:
    return request.config.cache.mkdir("roscpp")


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Iterator[World]:
    directory = tmp_path_factory.mktemp("sidecar_ipv6")
    names = directory / "hosts"
    names.write_text(NAMES)
    with two_hosts() as hosts:
        if not hosts.real:
            pytest.skip("needs hosts of its own: IPv4 is taken away from them")
        bare = Hosts(bared(hosts.near, names), bared(hosts.far, names), real=True)
        world = World(bare, Site(directory / "site"), directory, ipv6=True)
        world.enroll("/talker", publish="/chatter", provide="/talker/*")
        world.enroll("/listener", subscribe="/chatter", provide="/listener/*")
        world.enroll("/rostopic", wildcard=True, subscribe="/**", graph="/**")
        world.enroll("/rosservice", wildcard=True, call="/**", graph="/**")
        world.enroll("/rosparam", wildcard=True, param_set="/speed", param_get="/**")
        with world.master():
            yield world


@pytest.fixture(scope="module")
def talker(world: World) -> Iterator[Running]:
    words = ("rostopic", "pub", "-r", "10", "/chatter", "std_msgs/String", "hello", "__name:=talker")
    with world.secured(world.hosts.near, *words, options=("--as", "/talker")) as running:
        yield running


def test_the_hosts_have_no_ipv4(world: World) -> None:
    for host in (world.hosts.near, world.hosts.far):
        said = subprocess.run(host.at("ip", "-4", "-o", "addr"), check=True, capture_output=True, text=True)
        assert said.stdout == ""


def test_rospy_reaches_rospy_on_another_host(world: World, talker: Running) -> None:
    heard = world.tool("rostopic", "echo", "-n", "2", "/chatter")
    assert heard.count("data:") == 2, heard
    assert "/chatter" in world.tool("rostopic", "list")


def test_services_and_parameters_work_over_ipv6(world: World, talker: Running) -> None:
    service = "/talker/get_loggers"
    wait(lambda: service in world.tool("rosservice", "list"))
    assert "loggers" in world.tool("rosservice", "call", service)
    world.tool("rosparam", "set", "/speed", "1.5")
    assert world.tool("rosparam", "get", "/speed") == "1.5\n"


def test_roscpp_wants_ipv4_for_udpros_or_all_addresses(world: World, programs: Path) -> None:
    """With `localhost` it binds an unused UDP socket to 127.0.0.1, or exits."""
    program = str(compiled(programs)), "listener", "/chatter", "2"
    with world.secured(world.hosts.far, *program) as running:
        running.wait_for("Listen failed")
    everywhere = ("env", "ROS_HOSTNAME=ip6-localhost")
    with world.secured(world.hosts.far, *everywhere, *program) as running:
        running.wait_for("hello")
