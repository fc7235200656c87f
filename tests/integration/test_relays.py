"""Two sites that only their relays join, by a router: all forms reach each other as in one network.

A relay that is killed breaks connections as any host that goes; nodes come back by themselves.
"""

import contextlib
import re
import signal
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import pytest

from grants.model import Right
from tests.integration.foreignworld import LABEL, Cast, follow, pairs, prepare, running_programs, world
from tests.integration.sidecarworld import ROSSEC, Running, World, wait
from tests.support import relayprocess
from tests.support.kinds import KINDS, SEEN
from tests.support.ports import free_port
from tests.support.roscpp import compiled
from tests.support.trust import carry, share

pytestmark = [pytest.mark.ros, pytest.mark.timeout(180)]
FRAMES: Final = "/camera/frames"
CAMERA: Final = """
import asyncio
from rossec.node import Node
async def main():
    async with Node("/camera") as node:
        frames = await node.publisher("/camera/frames", "std_msgs/String")
        frame = frames.create(data="x" * 500_000)
        print("READY", flush=True)
        while True:
            frames.publish(frame)
            await asyncio.sleep(0.05)
asyncio.run(main())
"""
VIEWER: Final = """
import asyncio, sys
from rossec.node import Node
async def main(name):
    async with Node(name) as node:
        subscriber = await node.subscriber("/remote/hospital/camera/frames", "std_msgs/String")
        async for frame in subscriber:
            print("FRAME", len(frame.data), flush=True)
asyncio.run(main(sys.argv[1]))
"""


VICTIM: Final = (
    ROSSEC,
    "run",
    "--as",
    "/victim",
    "--",
    "sh",
    "-c",
    "rosparam set /victim/speed 'speed is 7';"  # noqa: ISC004 - one script
    " exec rostopic pub -r 1 /victim/word std_msgs/String word __name:=victim",
)


@dataclass(frozen=True)
class Sites:
    """The programs, and the relays of both sites by domain, which a test may kill."""

    cast: Cast
    stack: contextlib.ExitStack
    relays: dict[str, Running]
    router: Running
    port: int

    def start(self, side: World) -> None:
        """Start the relay of a site."""
        self.relays[side.site.anchor.domain] = self.stack.enter_context(relayprocess.relay(side))


@pytest.fixture(scope="module")
def sites(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Sites]:
    directory = tmp_path_factory.mktemp("relays")
    home, hospital = world(directory, "home"), world(directory, "hospital")
    port = free_port()
    for side in (home, hospital):
        relayprocess.seated(side, port)
    hospital.enroll("/camera", publish=FRAMES)
    for name in ("/quick", "/slow"):
        home.enroll(name)
    prepare(home, hospital)
    for name in ("/quick", "/slow"):
        share(hospital.site, home.site, name, Right.SUBSCRIBE, FRAMES)
    prepare_victim(home, hospital)
    for here, there in ((home, hospital), (hospital, home)):
        prepare_roscpp(here, there)
    relayprocess.exchange(home, "home", hospital, "hospital")
    with contextlib.ExitStack() as stack:
        router = stack.enter_context(relayprocess.router(home, port))
        for side, other in ((hospital, home), (home, hospital)):
            way = f"via: {other.site.anchor.domain}, parameters: [/victim/**]"
            stack.enter_context(side.master(*follow(other, way)))
        running = {
            side.site.anchor.domain: stack.enter_context(relayprocess.relay(side))
            for side in (hospital, home)
        }
        cast = stack.enter_context(running_programs(home, hospital, directory / "never"))
        yield Sites(cast, stack, running, router, port)


def prepare_victim(home: World, hospital: World) -> None:
    """A node of the hospital with a parameter, and one of the home that may stop it."""
    hospital.enroll("/victim", publish="/victim/word", provide="/victim/*", param_set="/victim/*")
    home.enroll("/killer", wildcard=True)
    home.enroll("/reader")
    for name, right, pattern in (
        ("/killer", Right.GRAPH, "/**"),
        ("/killer", Right.ADMIN, "/victim"),
        ("/killer", Right.CALL, "/victim/*"),
        ("/reader", Right.PARAM_GET, "/victim/**"),
        ("/master", Right.PARAM_GET, "/victim/**"),
    ):
        share(hospital.site, home.site, name, right, pattern)


def prepare_roscpp(here: World, there: World) -> None:
    """A talker here, and programs there that may hear and call it."""
    here.enroll("/cpp_talker", publish="/cpp/words", provide="/cpp_talker/say")
    share(here.site, there.site, "/master", Right.GRAPH, "/cpp/**")
    share(here.site, there.site, "/master", Right.GRAPH, "/cpp_talker/**")
    for name, right, pattern in (
        ("/cpp_listener", Right.SUBSCRIBE, "/cpp/words"),
        ("/cpp_caller", Right.CALL, "/cpp_talker/say"),
    ):
        there.enroll(name, provide=f"{name}/say")
        share(here.site, there.site, name, right, pattern)
    for side in (here, there):
        carry(side.site)


@pairs
def test_messages_come_by_the_relays(sites: Sites, source: str, sink: str) -> None:
    listener = sites.cast.listeners[sink]
    listener.wait_for(f"HEARD {LABEL}/{source} words {source} ")
    listener.wait_for(f"HEARD {LABEL}/{source} latched {source} kept")


@pairs
def test_publishers_filter_what_goes_by_the_relays(sites: Sites, source: str, sink: str) -> None:
    about = f"HEARD {LABEL}/{source} pose "
    listener = sites.cast.listeners[sink]
    wait(lambda: listener.said.count(about) > 3)
    poses = {line.removeprefix(about).strip() for line in listener.lines if line.startswith(about)}
    assert poses == {SEEN}


@pairs
def test_services_are_called_by_the_relays(sites: Sites, source: str, sink: str) -> None:
    for about in ("CALLED", "KEPT"):
        sites.cast.listeners[sink].wait_for(f"{about} {LABEL}/{source} {source} answers")


def test_stock_tools_work_by_the_relays(sites: Sites) -> None:
    cast = sites.cast
    cast.listeners["sidecar"].wait_for(f"HEARD {LABEL}/sidecar words")
    said = cast.tool("rostopic", "echo", "-n", "1", f"/{LABEL}/inprocess/latched")
    assert 'data: "inprocess kept"' in said
    called = cast.tool("rosservice", "call", f"/{LABEL}/sidecar/switch", "true")
    assert 'message: "sidecar answers"' in called
    said = cast.tool("rosnode", "info", f"/{LABEL}/sidecar_speaker")
    assert f" * topic: /{LABEL}/sidecar/words\n    * to: /sidecar_listener\n" in said
    assert "Unable to communicate" not in said


def test_nodes_are_pinged_and_stopped_and_parameters_read_by_the_relays(sites: Sites) -> None:
    """Who may not is told why by its sidecar: stock rosnode says "killed" to everybody."""
    cast, home, name = sites.cast, sites.cast.home, f"/{LABEL}/victim"
    with cast.hospital.started(cast.hospital.hosts.near, *VICTIM) as victim:
        ping = f"until rosnode ping -c 1 {name} | grep 'xmlrpc reply from'; do sleep 0.1; done"
        said = tools(home, "/rostopic", ping, f"rosnode kill {name}")
        assert "refuses shutdown: no grant for admin on /victim" in said
        assert victim.process.poll() is None
        tools(home, "/killer", f"rosnode kill {name}")
        assert victim.process.wait(20) == 0
        assert "shutdown request: user request" in victim.said
    read = f"until rosparam get {name}/speed | grep 'speed is 7'; do sleep 0.1; done"
    others = f"rosparam get /{LABEL}/other", f"rosparam set {name}/speed 1"
    said = tools(home, "/reader", read, *others)
    assert "needs the right param-get on hospital:/other" in said
    assert "names below /remote are those of other masters" in said


def tools(side: World, name: str, *lines: str) -> str:
    """What stock tools behind one sidecar print."""
    script = "sh", "-c", "; ".join(lines)
    done = side.run(side.hosts.far, *script, options=("--as", name))
    return done.stdout + done.stderr


def test_roscpp_programs_work_by_the_relays(sites: Sites, request: pytest.FixtureRequest) -> None:
    """Both ways at once, unmodified behind sidecars; then a service, once and persistent."""
    probe = str(compiled(request.config.cache.mkdir("roscpp")))
    sides = sites.cast.home, sites.cast.hospital
    with contextlib.ExitStack() as stack:

        def start(side: World, role: str, *words: str) -> Running:
            line = probe, role, *words, f"__name:=cpp_{role}"
            return stack.enter_context(side.secured(side.hosts.near, *line))

        talkers = [start(side, "talker", "/cpp/words") for side in sides]
        labels = [f"/remote/{other.site.anchor.domain}" for other in reversed(sides)]
        listeners = [
            start(side, "listener", f"{label}/cpp/words", "20")
            for side, label in zip(sides, labels, strict=True)
        ]
        callers = [
            start(side, "caller", f"{label}/cpp_talker/say", "3")
            for side, label in zip(sides, labels, strict=True)
        ]
        for listener in listeners:
            assert listener.process.wait(40) == 0, listener.said
            heard = re.findall(r"HEARD hello (\d+)", listener.said)
            assert list(map(int, heard)) == list(range(int(heard[0]), int(heard[0]) + 20))
        for caller, talker in zip(callers, reversed(talkers), strict=True):
            assert caller.process.wait(40) == 0, caller.said
            talker.wait_for("ASKED kept 2")
            assert re.findall("ASKED (.*) ", talker.said) == ["once", "kept 0", "kept 1", "kept 2"]


def test_a_subscriber_that_stands_still_slows_no_other(sites: Sites) -> None:
    home, hospital = sites.cast.home, sites.cast.hospital

    def start(side: World, source: str, *more: str) -> Running:
        line = (sys.executable, "-c", source, *more)
        return stack.enter_context(side.started(side.hosts.near, *line))

    with contextlib.ExitStack() as stack:
        start(hospital, CAMERA).wait_for("READY")
        quick, slow = (start(home, VIEWER, name) for name in ("/quick", "/slow"))
        for viewer in (quick, slow):
            viewer.wait_for("FRAME 500000")
        slow.process.send_signal(signal.SIGSTOP)
        time.sleep(0.3)  # what it wrote before is read
        stood, seen = len(slow.lines), len(quick.lines)
        wait(lambda: len(quick.lines) > seen + 60, within=15)  # at 20 a second
        words = f"HEARD {LABEL}/builtin words "
        heard = sites.cast.listeners["builtin"].said.count(words)
        wait(lambda: sites.cast.listeners["builtin"].said.count(words) > heard + 10, within=5)
        assert len(slow.lines) == stood
        slow.process.send_signal(signal.SIGCONT)
        wait(lambda: len(slow.lines) > stood + 40)


def test_no_connection_is_lost_while_the_only_router_is_away(sites: Sites) -> None:
    """Who connects anew gets the latched message again."""
    listeners = sites.cast.listeners.values()
    ways = [(listener, source) for listener in listeners for source in KINDS]

    def count(topic: str) -> list[int]:
        return [each.said.count(f"HEARD {LABEL}/{source} {topic} ") for each, source in ways]

    wait(lambda: 0 not in count("latched"))
    kept = count("latched")
    sites.router.end(signal.SIGKILL)
    stand_still(sites.cast)
    before = count("words")
    sites.stack.enter_context(relayprocess.router(sites.cast.home, sites.port))
    wait(lambda: all(now > then for now, then in zip(count("words"), before, strict=True)))
    assert count("latched") == kept


@pytest.mark.parametrize("killed", ["home", "hospital"])
def test_nodes_come_back_after_a_relay_was_killed(sites: Sites, killed: str) -> None:
    cast = sites.cast
    side = cast.home if killed == "home" else cast.hospital
    counted = [
        (listener, f"{about} {LABEL}/{source} {rest}")
        for listener in cast.listeners.values()
        for source in KINDS
        for about, rest in (("HEARD", "words "), ("CALLED", source), ("KEPT", source))
    ]

    def counts() -> list[int]:
        return [listener.said.count(words) for listener, words in counted]

    wait(lambda: 0 not in counts())
    sites.relays[killed].end(signal.SIGKILL)
    stand_still(cast)
    before = counts()
    sites.start(side)
    wait(lambda: all(now > then for now, then in zip(counts(), before, strict=True)), within=60)


def stand_still(cast: Cast) -> None:
    """No more messages arrive: there was no other way."""
    last, seen = -1, 0
    while last != seen:
        time.sleep(0.5)  # five messages of each publisher
        last, seen = seen, sum(each.said.count("HEARD") for each in cast.listeners.values())
