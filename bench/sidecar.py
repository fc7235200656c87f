"""Unmodified roscpp talker and listener: direct, through two sidecars, through two stunnels (TLS).

One run, interleaved: in each round every way is measured at every size, over a connection of its
own. A ratio is the median over the rounds of what two ways did in the same round, so that other
load hits both; `spread` is its quartiles. The talker is as fast as the listener hears. The tunnel
is given what it cannot find out by itself, a slave API that names the stunnel's port. `cpu_us` is
what both processes of a tunnel used for a message, the kernel's part included. Memory is that of
one `rossec sidecar` with 1 and with 50 nodes of own identities, beside stock roscore.
"""

import contextlib
import itertools
import json
import os
import select
import shutil
import subprocess
import sys
import tempfile
import threading
import time
import xmlrpc.client
from collections.abc import Iterator
from pathlib import Path
from statistics import median, quantiles
from typing import Any, Final
from xmlrpc.server import SimpleXMLRPCServer

from grants.model import Right
from rossec.node.questions import MASTER
from rossec.sidecar.loopback import free_port
from tests.support.roscpp import compiled
from tests.support.site import Site

SIZES: Final = {"100 B": 100, "10 kB": 10_000, "1 MB": 1_000_000}
NODES: Final = 50
WAYS: Final = ("plain", "stunnel", "sidecar")
ROUNDS: Final = 7
_SLOW: Final = 200  # messages a second, where latency is measured
_PATIENCE: Final = 60.0
_ROSSEC: Final = str(Path(sys.executable).parent / "rossec")
_ANY: Final[Any] = xmlrpc.client.ServerProxy


class Ways:
    """The three ways from a talker to a listener, all up for the whole run."""

    def __init__(self, directory: Path, stack: contextlib.ExitStack) -> None:
        self._directory = directory
        self._stack = stack
        self._load = str(compiled(directory, Path(__file__).with_name("load.cpp")))
        self.site = Site(directory / "site")
        newest = self.site.authority.store.newest_list()
        assert newest is not None
        self.site.enroll(MASTER).save_revocations(newest)
        self.plain, self.beyond, self.secure = (self._master(kind) for kind in "pts")
        self._topics = {
            **{f"/s{size}": (size, 0) for size in SIZES.values()},
            "/slow": (100, _SLOW),
        }
        self._tunnels: dict[tuple[str, str], list[int]] = {}
        for topic, (size, rate) in self._topics.items():
            self._talk(topic, size, rate)
        time.sleep(3)
        for topic in self._topics:
            self._tunnel(topic)
        masters = (self.plain, self.beyond, self.secure)
        self._listeners = {
            way: self._listen(way, uri) for way, uri in zip(WAYS, masters, strict=True)
        }

    def _env(self, uri: str) -> dict[str, str]:
        kept = {key: value for key, value in os.environ.items() if not key.startswith("ROS")}
        return kept | {
            "ROS_MASTER_URI": uri, "ROS_IP": "127.0.0.1", "ROSSEC_HOME": str(self.site.root),
            "ROS_HOME": str(self._directory), "ROS_LOG_DIR": str(self._directory),
        }  # fmt: skip

    def start(self, uri: str, *command: str, pipes: bool = False) -> "subprocess.Popen[bytes]":
        """Run until the end of the benchmark."""
        way = subprocess.PIPE if pipes else subprocess.DEVNULL
        process = subprocess.Popen(
            command, env=self._env(uri), stdin=way, stdout=way, stderr=subprocess.DEVNULL, bufsize=0
        )
        self._stack.callback(process.wait)
        self._stack.callback(process.terminate)
        return process

    def _master(self, kind: str) -> str:
        port = free_port()
        uri = f"http://127.0.0.1:{port}/"
        command = (_ROSSEC, "master") if kind == "s" else ("/usr/bin/rosmaster", "--core")
        self.start(uri, *command, "-p", str(port))
        return uri

    def _listen(self, way: str, uri: str) -> "subprocess.Popen[bytes]":
        prefix = (_ROSSEC, "run", "--") if way == "sidecar" else ()
        process = self.start(uri, *prefix, self._load, "sink", "__name:=listener", pipes=True)
        if way == "sidecar":
            for topic in self._topics:
                self._tunnels[way, topic].append(process.pid)
        return process

    def _talk(self, topic: str, size: int, rate: float) -> None:
        name = f"/talker{topic.replace('/', '_')}"
        self.site.publish(name, topic)
        self.site.publish(name, "/rosout")
        words = (self._load, "flood", topic, str(size), str(rate), f"__name:={name[1:]}")
        self.start(self.plain, *words)
        process = self.start(self.secure, _ROSSEC, "run", "--", *words)
        self._tunnels["plain", topic] = []
        self._tunnels["sidecar", topic] = [process.pid]
        self.site.subscribe("/listener", topic)

    def _tunnel(self, topic: str) -> None:
        """Two stunnels before the plain talker, and a slave API that leads to them."""
        name = f"/talker{topic.replace('/', '_')}"
        _, _, uri = _ANY(self.plain).lookupNode("/bench", name)
        _, _, (_, _, target) = _ANY(uri).requestTopic("/bench", topic, [["TCPROS"]])
        near, far = free_port(), free_port()
        own = self._directory / f"stunnel{topic.replace('/', '_')}"
        own.mkdir()
        _certificate(own)
        for role, accept, to in (("yes", near, far), ("no", far, target)):
            config = own / f"{role}.conf"
            config.write_text(
                f"foreground = yes\npid =\nsslVersion = TLSv1.3\nsocket = l:TCP_NODELAY=1\n"
                f"socket = r:TCP_NODELAY=1\n[ros]\nclient = {role}\naccept = 127.0.0.1:{accept}\n"
                f"connect = 127.0.0.1:{to}\ncert = {own}/cert.pem\nkey = {own}/key.pem\n"
            )
            process = self.start(self.beyond, shutil.which("stunnel4") or "stunnel", str(config))
            self._tunnels.setdefault(("stunnel", topic), []).append(process.pid)
        server = SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False, allow_none=True)
        server.register_function(
            lambda *_: [1, "ready", ["TCPROS", "127.0.0.1", near]], "requestTopic"
        )
        threading.Thread(target=server.serve_forever, daemon=True).start()
        self._stack.callback(server.shutdown)
        own_uri = f"http://127.0.0.1:{server.server_address[1]}/"
        _ANY(self.beyond).registerPublisher(name, topic, "std_msgs/String", own_uri)

    def listen(self, way: str, topic: str, seconds: float) -> dict[str, float]:
        """What a listener hears in so many seconds, and what the tunnel used for each message."""
        listener, processes = self._listeners[way], self._tunnels[way, topic]
        assert listener.stdin is not None
        assert listener.stdout is not None
        listener.stdin.write(f"{topic} {seconds}\n".encode())
        ready, _, _ = select.select([listener.stdout], [], [], _PATIENCE)
        assert ready, f"nothing is heard {way} on {topic}"
        assert listener.stdout.readline() == b"begin\n"
        before = sum(map(_used, processes))
        found: dict[str, float] = json.loads(listener.stdout.readline())
        found["cpu_us"] = (sum(map(_used, processes)) - before) / found["messages"] * 1e6
        return found


def _used(process: int) -> float:
    """Seconds of CPU time, of threads that have ended as well: clock_getcpuclockid(3)."""
    return time.clock_gettime(~process << 3 | 2)


def _certificate(directory: Path) -> None:
    subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256",
         "-nodes", "-subj", "/CN=bench", "-keyout", f"{directory}/key.pem",
         "-out", f"{directory}/cert.pem", "-days", "2"],
        check=True, capture_output=True,
    )  # fmt: skip


def _resident(process: int) -> float:
    """Resident memory in MB."""
    status = Path(f"/proc/{process}/status").read_text()
    (line,) = (line for line in status.splitlines() if line.startswith("VmRSS"))
    return int(line.split()[1]) / 1024


@contextlib.contextmanager
def _host_sidecar(ways: Ways) -> Iterator[tuple[int, str]]:
    port = free_port()
    process = ways.start(ways.secure, _ROSSEC, "sidecar", "-p", str(port))
    time.sleep(2)
    yield process.pid, f"http://127.0.0.1:{port}/"


def _register(uri: str, name: str) -> None:
    master, own = _ANY(uri), f"http://127.0.0.1:{free_port()}/"
    for method, topic in (("registerPublisher", f"{name}/out"), ("registerSubscriber", "/in")):
        code, status, _ = getattr(master, method)(name, topic, "std_msgs/String", own)
        assert code == 1, status


def memory(ways: Ways) -> dict[str, float]:
    """Of one sidecar with so many nodes, and of stock roscore."""
    names = [f"/node{number}" for number in range(NODES)]
    for name in names:
        ways.site.publish(name, f"{name}/out")
        ways.site.grant(name, Right.SUBSCRIBE, "/in")
    found: dict[str, float] = {}
    with _host_sidecar(ways) as (process, uri):
        _register(uri, names[0])
        found["1"] = round(_resident(process), 1)
        for name in names[1:]:
            _register(uri, name)
        time.sleep(2)
        found[str(NODES)] = round(_resident(process), 1)
    port = free_port()
    core = ways.start(f"http://127.0.0.1:{port}/", "/usr/bin/rosmaster", "--core", "-p", str(port))
    out = ways.start(f"http://127.0.0.1:{port}/", "/usr/lib/rosout/rosout")
    time.sleep(3)
    for name in names:
        _register(f"http://127.0.0.1:{port}/", name)
    found["roscore"] = round(_resident(core.pid) + _resident(out.pid), 1)
    return found


class Heard:
    """What was heard in each round, by way and by size (or "slow")."""

    def __init__(self) -> None:
        self._found: dict[tuple[str, str], list[dict[str, float]]] = {}

    def add(self, way: str, label: str, found: dict[str, float]) -> None:
        """Another round."""
        self._found.setdefault((way, label), []).append(found)

    def _pairs(self, label: str, key: str, way: str, other: str) -> list[tuple[float, float]]:
        both = (self._found[each, label] for each in (way, other))
        return [(ours[key], theirs[key]) for ours, theirs in zip(*both, strict=True)]

    def _ratios(self, label: str, other: str) -> list[float]:
        pairs = self._pairs(label, "mb_per_s", "sidecar", other)
        return [ours / theirs for ours, theirs in pairs]

    def middle(self, way: str, label: str, key: str) -> float:
        """The median of one figure."""
        return round(median(found[key] for found in self._found[way, label]), 1)

    def throughput_versus(self, other: str) -> dict[str, float]:
        """The sidecar's, by size."""
        return {label: round(median(self._ratios(label, other)), 2) for label in SIZES}

    def spread(self, label: str, other: str) -> list[float]:
        """The quartiles of that."""
        low, _, high = quantiles(self._ratios(label, other))
        return [round(low, 2), round(high, 2)]

    def added(self, way: str) -> float:
        """How much older messages are than without a tunnel."""
        pairs = self._pairs("slow", "age_us", way, "plain")
        return round(median(ours - plain for ours, plain in pairs), 1)


def measure(seconds: float) -> dict[str, Any]:
    """All ways, sizes and memories."""
    each = max(0.2, seconds / (ROUNDS * len(WAYS) * (len(SIZES) + 1)))
    topics = {label: f"/s{size}" for label, size in SIZES.items()} | {"slow": "/slow"}
    heard = Heard()
    with contextlib.ExitStack() as stack:
        directory = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        ways = Ways(directory, stack)
        for number in range(ROUNDS + 1):
            for (label, topic), way in itertools.product(topics.items(), WAYS):
                found = ways.listen(way, topic, each)
                if number > 0:  # the first round warms up
                    heard.add(way, label, found)
        resident = memory(ways)
    return {
        "megabytes_per_s": {
            way: {label: heard.middle(way, label, "mb_per_s") for label in SIZES} for way in WAYS
        },
        "throughput_vs_stunnel": heard.throughput_versus("stunnel"),
        "throughput_vs_plain": heard.throughput_versus("plain"),
        "spread": {
            f"{label} vs {other}": heard.spread(label, other)
            for label in SIZES
            for other in WAYS[:2]
        },
        "cpu_us": {
            way: {label: heard.middle(way, label, "cpu_us") for label in topics} for way in WAYS[1:]
        },
        "latency_us_p50": {way: heard.middle(way, "slow", "age_us") for way in WAYS},
        "latency_added_us_p50": heard.added("sidecar"),
        "latency_added_by_stunnel_us_p50": heard.added("stunnel"),
        "rss_mb": {"1": resident["1"], str(NODES): resident[str(NODES)]},
        "rss_vs_roscore": round(resident[str(NODES)] / resident["roscore"], 2),
        "rss_roscore_mb": resident["roscore"],
    }
