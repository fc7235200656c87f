"""Every form of a node gets a hospital's topics from the gateway of its own site.

A hospital and a home, each with a master; everything is a process. The home's nodes hold no right
to any topic at the hospital, the gateway does, and the home grants what it serves. Services are
called where they are: they go by no gateway.
"""

import contextlib
import re
import signal
import sys
from collections.abc import Iterator
from typing import Final

import pytest

from grants.model import Right
from tests.integration.foreignworld import LABEL, TOOL, Cast, follow, pairs, running_programs, world
from tests.integration.sidecarworld import ROSSEC, Running, World, wait
from tests.support.fleet import SECURE
from tests.support.kinds import KINDS, SEEN, command
from tests.support.roscpp import compiled
from tests.support.site import coarse
from tests.support.trust import accept, carry, share

pytestmark = [pytest.mark.ros, pytest.mark.timeout(180)]

TOPICS: Final = ("words", "latched", "pose")
SERVED: Final = "/gateway/hospital"


_ROSPY_ROVER: Final = f"""
import sys, rospy
from std_msgs.msg import String
rospy.init_node(f"{{sys.argv[1]}}_rover")
def hear(message):
    sys.stdout.write(f"HEARD {LABEL}/builtin words {{message.data}}\\n")
    sys.stdout.flush()
rospy.Subscriber("/{LABEL}/builtin/words", String, hear)
rospy.spin()
"""
_BUILTIN_ROVER: Final = f"""
import asyncio, sys
from rossec.node import Node
async def main():
    async with Node(f"/{{sys.argv[1]}}_rover") as node:
        async for message in await node.subscriber("/{LABEL}/builtin/words", "std_msgs/String"):
            print(f"HEARD {LABEL}/builtin words {{message.data}}", flush=True)
asyncio.run(main())
"""
ROVERS: Final = {"inprocess": SECURE + _ROSPY_ROVER, "builtin": _BUILTIN_ROVER, "sidecar": _ROSPY_ROVER}


class Sites:
    """Both sites, their programs, and the gateway, which is killed and started again."""

    def __init__(self, cast: Cast, stack: contextlib.ExitStack) -> None:
        self.cast, self._stack = cast, stack
        self.gateway = self.start_gateway()

    def start_gateway(self) -> Running:
        home = self.cast.home
        line = ROSSEC, "gateway", "--from", "hospital", "/*/words", "/*/latched", "/*/pose"
        self.gateway = self._stack.enter_context(home.started(home.hosts.near, *line))
        self.gateway.wait_for("gateway /gateway serves topics of hospital")
        return self.gateway

    def kill_gateway(self) -> None:
        self.gateway.end(signal.SIGKILL)


def prepare(home: World, hospital: World) -> None:
    """Who may do what; lists of domains are in every home."""
    accept(home.site, hospital.site, "hospital")
    accept(hospital.site, home.site, "home")
    home.enroll("/gateway", publish=f"{SERVED}/**", graph="/master")
    for topic in ("words", "latched"):
        share(hospital.site, home.site, "/gateway", Right.SUBSCRIBE, f"/*/{topic}")
    share(hospital.site, home.site, "/gateway", Right.SUBSCRIBE, "/*/pose", coarse())
    for kind in KINDS:
        hospital.enroll(f"/{kind}_speaker", publish=f"/{kind}/*", provide=f"/{kind}/*")
        listener = f"/{kind}_listener"
        home.enroll(listener, subscribe=" ".join(f"{SERVED}/*/{topic}" for topic in TOPICS))
        share(hospital.site, home.site, listener, Right.CALL, "/*/switch")
        home.enroll(f"/{kind}_rover", subscribe=f"{SERVED}/builtin/words")
        share(hospital.site, home.site, f"/{kind}_rover", Right.SUBSCRIBE, "/builtin/words")
    home.enroll(
        "/rostopic",
        wildcard=True,
        subscribe=f"{SERVED}/**",
        graph="/**",
        publish="/**",
        param_set="/**",
        provide="/**",
    )
    home.enroll("/cpp_listener", subscribe=f"{SERVED}/sidecar/words", provide="/cpp_listener/say")
    share(hospital.site, home.site, "/master", Right.GRAPH, "/**")
    share(home.site, hospital.site, "/master", Right.GRAPH, "/master")
    for side in (home, hospital):
        carry(side.site)


@pytest.fixture(scope="module")
def sites(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Sites]:
    directory = tmp_path_factory.mktemp("gateway")
    home, hospital = world(directory, "home"), world(directory, "hospital")
    prepare(home, hospital)
    with contextlib.ExitStack() as stack:
        for side, other in ((hospital, home), (home, hospital)):
            way = f"uri: 'http://127.0.0.1:{other.port}'"
            stack.enter_context(side.master(*follow(other, way)))
        cast = stack.enter_context(running_programs(home, hospital, directory / "never"))
        sites = Sites(cast, stack)
        yield sites
        assert "Traceback" not in sites.gateway.said, sites.gateway.said


@pairs
def test_messages_arrive_at_every_form(sites: Sites, source: str, sink: str) -> None:
    listener = sites.cast.listeners[sink]
    listener.wait_for(f"HEARD {LABEL}/{source} words {source} ")
    listener.wait_for(f"HEARD {LABEL}/{source} latched {source} kept")


@pairs
def test_the_filters_of_the_gateways_grant_hold(sites: Sites, source: str, sink: str) -> None:
    about = f"HEARD {LABEL}/{source} pose "
    listener = sites.cast.listeners[sink]
    wait(lambda: listener.said.count(about) > 3)
    poses = {line.removeprefix(about).strip() for line in listener.lines if line.startswith(about)}
    assert poses == {SEEN}


@pairs
def test_services_are_called_where_they_are(sites: Sites, source: str, sink: str) -> None:
    sites.cast.listeners[sink].wait_for(f"CALLED {LABEL}/{source} {source} answers")


def test_the_hospital_has_one_subscriber(sites: Sites) -> None:
    for listener in sites.cast.listeners.values():
        for kind in KINDS:
            listener.wait_for(f"HEARD {LABEL}/{kind} words")
    for speaker in sites.cast.speakers.values():
        assert set(re.findall(r"LISTENERS words (\d)", speaker.said)) <= {"0", "1"}, speaker.said


def test_stock_tools_list_and_receive_what_is_served(sites: Sites) -> None:
    tool = sites.cast.tool
    listed = tool("rostopic", "list").split()
    assert {f"/{LABEL}/{kind}/words" for kind in KINDS} <= set(listed)
    said = tool("rostopic", "info", f"/{LABEL}/inprocess/words")
    assert "Type: std_msgs/String" in said
    assert " * /builtin_listener (http://127.0.0.1:" in said
    said = tool("rostopic", "echo", "-n", "1", f"/{LABEL}/inprocess/latched")
    assert 'data: "inprocess kept"' in said
    line = (ROSSEC, "run", *TOOL, "--", "rostopic", "hz", f"/{LABEL}/sidecar/words")
    with sites.cast.home.started(sites.cast.home.hosts.far, *line) as running:
        running.wait_for("average rate: ")


def test_a_roscpp_program_receives_what_is_served(sites: Sites, request: pytest.FixtureRequest) -> None:
    probe = str(compiled(request.config.cache.mkdir("roscpp")))
    home = sites.cast.home
    line = probe, "listener", f"/{LABEL}/sidecar/words", "20", "__name:=cpp_listener"
    with home.secured(home.hosts.near, *line) as listener:
        assert listener.process.wait(40) == 0, listener.said
    heard = re.findall(r"HEARD sidecar (\d+)", listener.said)
    assert list(map(int, heard)) == list(range(int(heard[0]), int(heard[0]) + 20))


def numbers(listener: Running, kind: str) -> list[int]:
    """The numbered words of a speaker that a program has heard."""
    return list(map(int, re.findall(rf"HEARD {LABEL}/{kind} words {kind} (\d+)", listener.said)))


def goes_on(listener: Running, kind: str) -> None:
    """It hears words that are spoken from now on: what was under way is a second old at most."""
    last = numbers(listener, kind)[-1]
    wait(lambda: numbers(listener, kind)[-1] > last + 20)


def test_every_form_hears_a_gateway_that_was_killed_and_is_back(sites: Sites) -> None:
    sites.kill_gateway()
    sites.start_gateway()
    for listener in sites.cast.listeners.values():
        for kind in KINDS:
            goes_on(listener, kind)


def test_every_form_changes_between_gateway_and_hospital(sites: Sites) -> None:
    """The rovers have the right from both sides; the speaker counts who is connected to it."""
    home, speaker = sites.cast.home, sites.cast.speakers["builtin"]

    def connected(count: int) -> bool:
        counts: list[str] = re.findall(r"LISTENERS words (\d)", speaker.said)
        return counts[-1] == str(count)

    with contextlib.ExitStack() as stack:
        rovers = [
            stack.enter_context(home.started(home.hosts.near, *line))
            for line in (command(kind, sys.executable, ROSSEC, ROVERS[kind]) for kind in KINDS)
        ]
        for rover in rovers:
            rover.wait_for(f"HEARD {LABEL}/builtin words ")
        wait(lambda: connected(1))
        sites.kill_gateway()
        wait(lambda: connected(len(rovers)))
        for rover in rovers:
            goes_on(rover, "builtin")
        sites.start_gateway()
        wait(lambda: connected(1))
        for rover in rovers:
            goes_on(rover, "builtin")
            heard = numbers(rover, "builtin")
            assert len(heard) - len(set(heard)) < 30, "for a moment it may have both"
