"""Unmodified roscpp talker and listener: direct, through two sidecars, through two stunnels (TLS).

One run, interleaved: in each round every way is measured at every size. The tunnel is given what it
cannot find out by itself, a slave API that names the stunnel's port. Memory is that of one
`rossec sidecar` with 1 and with 50 nodes of own identities, beside stock roscore.
"""

import contextlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
import xmlrpc.client
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from typing import Any, Final
from xmlrpc.server import SimpleXMLRPCServer

from grants.model import Right
from rossec.node.questions import MASTER
from rossec.sidecar.loopback import free_port
from tests.support.roscpp import compiled
from tests.support.site import Site

SIZES: Final = {"100 B": 100, "10 kB": 10_000, "1 MB": 1_000_000}
NODES: Final = 50
_SLOW: Final = 200  # messages a second, where latency is measured
_ROSSEC: Final = str(Path(sys.executable).parent / "rossec")
_ANY: Final[Any] = xmlrpc.client.ServerProxy


class Ways:
    """The three ways from a talker to a listener, all up for the whole run."""

    def __init__(self, directory: Path, stack: contextlib.ExitStack) -> None:
        self._directory = directory
        self._stack = stack
        self._probe = str(compiled(directory))
        self.site = Site(directory / "site")
        newest = self.site.authority.store.newest_list()
        assert newest is not None
        self.site.enroll(MASTER).save_revocations(newest)
        self.plain, self.beyond, self.secure = (self._master(kind) for kind in "pts")
        self._topics = {
            **{f"/s{size}": (size, 1e6) for size in SIZES.values()},
            "/slow": (100, _SLOW),
        }
        for topic, (size, rate) in self._topics.items():
            self._talk(topic, size, rate)
        time.sleep(3)
        for topic in self._topics:
            self._tunnel(topic)

    def _env(self, uri: str) -> dict[str, str]:
        kept = {key: value for key, value in os.environ.items() if not key.startswith("ROS")}
        return kept | {
            "ROS_MASTER_URI": uri, "ROS_IP": "127.0.0.1", "ROSSEC_HOME": str(self.site.root),
            "ROS_HOME": str(self._directory), "ROS_LOG_DIR": str(self._directory),
        }  # fmt: skip

    def start(self, uri: str, *command: str) -> "subprocess.Popen[bytes]":
        """Run until the end of the benchmark."""
        process = subprocess.Popen(
            command, env=self._env(uri), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
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

    def _talk(self, topic: str, size: int, rate: float) -> None:
        name = f"/talker{topic.replace('/', '_')}"
        self.site.publish(name, topic)
        self.site.publish(name, "/rosout")
        words = (self._probe, "flood", topic, str(size), str(rate), f"__name:={name[1:]}")
        self.start(self.plain, *words)
        self.start(self.secure, _ROSSEC, "run", "--", *words)
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
            self.start(self.beyond, shutil.which("stunnel4") or "stunnel", str(config))
        server = SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False, allow_none=True)
        server.register_function(
            lambda *_: [1, "ready", ["TCPROS", "127.0.0.1", near]], "requestTopic"
        )
        threading.Thread(target=server.serve_forever, daemon=True).start()
        self._stack.callback(server.shutdown)
        own_uri = f"http://127.0.0.1:{server.server_address[1]}/"
        _ANY(self.beyond).registerPublisher(name, topic, "std_msgs/String", own_uri)

    def listen(self, way: str, topic: str, seconds: float) -> dict[str, float]:
        """What a listener hears in so many seconds."""
        uri = {"plain": self.plain, "stunnel": self.beyond, "sidecar": self.secure}[way]
        prefix = (_ROSSEC, "run", "--") if way == "sidecar" else ()
        done = subprocess.run(
            [*prefix, self._probe, "sink", topic, str(seconds), "__name:=listener"],
            env=self._env(uri), capture_output=True, text=True, timeout=60, check=True,
        )  # fmt: skip
        found: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
        return found


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


def measure(seconds: float) -> dict[str, Any]:
    """All ways, sizes and memories."""
    ways_names = ("plain", "stunnel", "sidecar")
    with contextlib.ExitStack() as stack:
        directory = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        ways = Ways(directory, stack)
        rounds = 3
        each = max(0.5, seconds / (rounds * len(ways_names) * (len(SIZES) + 1)))
        speeds: dict[tuple[str, str], list[float]] = {}
        ages: dict[str, list[float]] = {way: [] for way in ways_names}
        for _ in range(rounds):
            for label, size in SIZES.items():
                for way in ways_names:
                    heard = ways.listen(way, f"/s{size}", each)
                    speeds.setdefault((way, label), []).append(heard["bytes_per_s"] / 1e6)
            for way in ways_names:
                ages[way].append(ways.listen(way, "/slow", each)["age_us"])
        resident = memory(ways)
    speed = {key: median(values) for key, values in speeds.items()}
    latency = {way: round(median(values), 1) for way, values in ages.items()}
    return {
        "megabytes_per_s": {
            way: {label: round(speed[way, label], 1) for label in SIZES} for way in ways_names
        },
        "throughput_vs_stunnel": {
            label: round(speed["sidecar", label] / speed["stunnel", label], 2) for label in SIZES
        },
        "throughput_vs_plain": {
            label: round(speed["sidecar", label] / speed["plain", label], 2) for label in SIZES
        },
        "latency_us_p50": latency,
        "latency_added_us_p50": round(latency["sidecar"] - latency["plain"], 1),
        "latency_added_by_stunnel_us_p50": round(latency["stunnel"] - latency["plain"], 1),
        "rss_mb": {"1": resident["1"], str(NODES): resident[str(NODES)]},
        "rss_vs_roscore": round(resident[str(NODES)] / resident["roscore"], 2),
        "rss_roscore_mb": resident["roscore"],
    }
