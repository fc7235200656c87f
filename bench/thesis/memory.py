"""Experiment 5.1: memory of a full ROS system, and of what rossec needs on a host. MB are Pss.

The proportional set size counts a page that several processes share as the part of each, so that a
sum of processes is what they need together. The thesis measured roscore, rosmaster, rosout and its
multimaster process, and its proxy master; here these are Debian's roscore with its children, and
`rossec master`, which follows other masters itself, the sidecar of a host, relay and gateway. For
each node: what registering many of them adds, by plain calls at rosmaster and by nodes with a
connection of their own at rossec's.
"""

import asyncio
import sys
import time
import xmlrpc.client
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any, Final

from bench._sites import Slave, enroll_masters, slave
from bench.thesis.gateways import GATEWAY
from bench.thesis.programs import Program, Programs, programs
from bench.thesis.talk import TOPIC
from grants.model import Right
from rossec.host.callers import descendants, parents
from rossec.overlay.documents import OPEN_ACCOUNT, Routers
from rossec.ros.names import MASTER
from tests.support.hosts import Host
from tests.support.ports import free_port
from tests.support.site import Site
from tests.support.trust import accept, share

PLAIN_NODES: Final = 1000  # a node is less than a page there
NODES: Final = 100
PROGRAMS: Final = 8  # rospy nodes behind the sidecar
_HERE: Final = Host((), "127.0.0.1", "::1")
_TYPE: Final = "std_msgs/String"
_OTHER: Final = "other"  # another trust domain
_SETTLED: Final = 3.0  # seconds


def pss(text: str) -> int:
    """The proportional set size in kB, from a process's `smaps_rollup`."""
    return next(int(line.split()[1]) for line in text.splitlines() if line.startswith("Pss:"))


def used(*programs: Program) -> float:
    """MB of programs, and of all that they started."""
    known = parents()
    processes = {each for program in programs for each in (program.pid, *descendants(known, program.pid))}
    total = sum(pss(Path(f"/proc/{each}/smaps_rollup").read_text()) for each in processes)
    return round(total / 1000, 2)


def measure(directory: Path) -> dict[str, Any]:
    """All of it."""
    with programs(directory) as running:
        full = _stock(running)
    with programs(directory) as running:
        ours = _ours(running)
    return {**full, **ours}


def _stock(running: Programs) -> dict[str, Any]:
    """`full`: roscore with rosmaster and rosout."""
    port, folder = free_port(), str(running.directory)
    uri = uri_at(port)
    environ = {"ROS_MASTER_URI": uri, "ROS_IP": "127.0.0.1", "ROS_HOME": folder, "ROS_LOG_DIR": folder}
    core = running.start("roscore", _HERE, environ, "/usr/bin/roscore", "-p", str(port))
    master = xmlrpc.client.ServerProxy(uri)
    _wait_for_rosout(master)
    time.sleep(_SETTLED)
    before = used(core)
    for number in range(PLAIN_NODES):
        master.registerPublisher(f"/n{number}", f"/n{number}/t", _TYPE, f"http://10.0.0.1:{number}")
    time.sleep(_SETTLED)
    return {"full": before, "full_kb_a_node": _each(before, used(core), PLAIN_NODES)}


def _wait_for_rosout(master: Any) -> None:
    end = time.monotonic() + 60
    while time.monotonic() < end:
        try:
            code, _, _ = master.lookupNode("/bench", "/rosout")
        except OSError:
            code = 0
        if code == 1:
            return
        time.sleep(0.2)
    raise RuntimeError("roscore does not start")


def _ours(running: Programs) -> dict[str, Any]:
    """`master`, `sidecar`, `relay` and `gateway`, each a process."""
    site, port = Site(running.directory / "site"), free_port()
    enroll_masters(site, [MASTER])
    site.enroll("/relay")
    _trust_other(site, running.directory)
    environ = {"ROSSEC_HOME": str(site.root), "ROS_IP": "127.0.0.1", "ROS_MASTER_URI": uri_at(port)}
    master = running.rossec(_HERE, environ, "master", "--json", "-p", str(port))
    master.line()
    relay = _relay(running, environ)
    sidecar_port = free_port()
    sidecar = running.rossec(_HERE, environ, "sidecar", "-p", str(sidecar_port))
    gateway = running.rossec(_HERE, environ, "gateway", "--json", "--from", _OTHER, "/**")
    gateway.line()
    time.sleep(_SETTLED)
    processes = {"master": master, "sidecar": sidecar, "relay": relay, "gateway": gateway}
    found = {name: used(process) for name, process in processes.items()}
    _start_programs(running, site, {**environ, "ROS_MASTER_URI": uri_at(sidecar_port)})
    behind = used(sidecar)
    before = used(master)
    after = asyncio.run(_with_nodes(site, port, master))
    return {
        **found,
        "sidecar_kb_a_node": _each(found["sidecar"], behind, PROGRAMS),
        "master_kb_a_node": _each(before, after, NODES),
    }


def _trust_other(site: Site, directory: Path) -> None:
    """A gateway of the site, with a grant of another domain, of which nothing runs."""
    other = Site(directory / _OTHER, _OTHER)
    accept(other, site)
    home = site.enroll(GATEWAY)
    (home.path / "domains.cose").write_bytes(accept(site, other))
    site.grant(GATEWAY, Right.GRAPH, "/**")
    share(other, site, GATEWAY, Right.SUBSCRIBE, "/**")


def _start_programs(running: Programs, site: Site, environ: dict[str, str]) -> None:
    """Start rospy nodes with a topic each, whose master is the sidecar."""
    names = [f"/program{number}" for number in range(PROGRAMS)]
    for name in names:
        site.publish(name, TOPIC)
        site.grant(name, Right.PROVIDE, f"{name}/*")  # every rospy node has two services
    folder = str(running.directory)
    own = {**environ, "ROS_HOME": folder, "ROS_LOG_DIR": folder}
    command = (sys.executable, "-m", "bench.thesis.stock")
    started = [running.start("program", _HERE, own, *command, name, "publish") for name in names]
    for each in started:
        each.answer()
    time.sleep(_SETTLED)


def uri_at(port: int) -> str:
    """Of a master on this host."""
    return f"http://127.0.0.1:{port}/"


def _relay(running: Programs, environ: dict[str, str]) -> Program:
    """A relay with a session at a router, and no links."""
    locator = f"tcp/127.0.0.1:{free_port()}"
    home = str(running.directory / "router")
    router = running.rossec(_HERE, {}, "router", "--home", home, "--listen", locator, "--open", "--json")
    router.line()
    account = running.directory / "account.json"
    account.write_bytes(Routers((locator,), OPEN_ACCOUNT).write())
    relay = running.rossec(_HERE, environ, "relay", "--account", str(account), "--json")
    relay.line()
    return relay


async def _with_nodes(site: Site, port: int, master: Program) -> float:
    """MB of the master with nodes, each with its connection and a topic."""
    async with AsyncExitStack() as stack:
        for number in range(NODES):
            node: Slave = await stack.enter_async_context(slave(site, f"/n{number}", port))
            await node.ask("registerPublisher", f"{node.name}/t", _TYPE, node.uri)
        await asyncio.sleep(_SETTLED)
        return used(master)


def _each(before: float, after: float, nodes: int) -> float:
    """kB for each node."""
    return round((after - before) * 1000 / nodes, 1)
