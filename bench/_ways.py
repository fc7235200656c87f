"""Ways from a roscpp talker to a roscpp listener: direct, two stunnels (TLS), two sidecars."""

import contextlib
import json
import os
import select
import shutil
import socket
import subprocess
import sys
import threading
import time
import xmlrpc.client
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final
from xmlrpc.server import SimpleXMLRPCServer

from rossec.host.local_ports import free_port
from rossec.ros.names import MASTER
from tests.support.roscpp import compiled
from tests.support.site import Site

SIZES: Final = {"100 B": 100, "10 kB": 10_000, "1 MB": 1_000_000}
WAYS: Final = ("plain", "stunnel", "sidecar")
_SLOW: Final = 200  # messages a second, where latency is measured
_PATIENCE: Final = 60.0
_ROSSEC: Final = str(Path(sys.executable).parent / "rossec")


def master(uri: str) -> Any:
    """Its API, as methods."""
    return xmlrpc.client.ServerProxy(uri)


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
        self.plain, self.beyond = self.stock_master()[1], self.stock_master()[1]
        self.secure = self._master(_ROSSEC, "master")[1]
        self._topics = {**{f"/s{size}": (size, 0) for size in SIZES.values()}, "/slow": (100, _SLOW)}
        self._tunnels: dict[tuple[str, str], list[int]] = {}
        for topic, (size, rate) in self._topics.items():
            self._talk(topic, size, rate)
        for topic in self._topics:
            self._tunnel(topic)
        masters = (self.plain, self.beyond, self.secure)
        self._listeners = {way: self._listen(way, uri) for way, uri in zip(WAYS, masters, strict=True)}

    def _env(self, uri: str) -> dict[str, str]:
        kept = {key: value for key, value in os.environ.items() if not key.startswith("ROS")}
        return kept | {
            "ROS_MASTER_URI": uri,
            "ROS_IP": "127.0.0.1",
            "ROSSEC_HOME": str(self.site.root),
            "ROS_HOME": str(self._directory),
            "ROS_LOG_DIR": str(self._directory),
        }

    def start(self, uri: str, *command: str, pipes: bool = False) -> "subprocess.Popen[bytes]":
        """Run until the end of the benchmark."""
        way = subprocess.PIPE if pipes else subprocess.DEVNULL
        process = subprocess.Popen(
            command, env=self._env(uri), stdin=way, stdout=way, stderr=subprocess.DEVNULL, bufsize=0
        )
        self._stack.callback(process.wait)
        self._stack.callback(process.terminate)
        return process

    def stock_master(self) -> tuple["subprocess.Popen[bytes]", str]:
        """Another rosmaster, and its URI."""
        return self._master("/usr/bin/rosmaster", "--core")

    def host_sidecar(self) -> tuple["subprocess.Popen[bytes]", str]:
        """A `rossec sidecar`, and the URI of its loopback master."""
        port = free_port()
        process = self.start(self.secure, _ROSSEC, "sidecar", "-p", str(port))
        _reached(port)
        return process, f"http://127.0.0.1:{port}/"

    def _master(self, *command: str) -> tuple["subprocess.Popen[bytes]", str]:
        port = free_port()
        uri = f"http://127.0.0.1:{port}/"
        process = self.start(uri, *command, "-p", str(port))
        _reached(port)
        return process, uri

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
        slave = master(registered(self.plain, name))
        where = ["", "", 0]
        for _ in _retry(topic):
            code, _, where = slave.requestTopic("/bench", topic, [["TCPROS"]])
            if code == 1:
                break
        near, far = free_port(), free_port()
        own = self._directory / f"stunnel{topic.replace('/', '_')}"
        own.mkdir()
        _certificate(own)
        for role, accept, to in (("yes", near, far), ("no", far, where[2])):
            config = own / f"{role}.conf"
            config.write_text(
                f"foreground = yes\npid =\nsslVersion = TLSv1.3\nsocket = l:TCP_NODELAY=1\n"
                f"socket = r:TCP_NODELAY=1\n[ros]\nclient = {role}\naccept = 127.0.0.1:{accept}\n"
                f"connect = 127.0.0.1:{to}\ncert = {own}/cert.pem\nkey = {own}/key.pem\n"
            )
            process = self.start(self.beyond, shutil.which("stunnel4") or "stunnel", str(config))
            self._tunnels.setdefault(("stunnel", topic), []).append(process.pid)
        server = SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False, allow_none=True)
        server.register_function(lambda *_: [1, "ready", ["TCPROS", "127.0.0.1", near]], "requestTopic")
        threading.Thread(target=server.serve_forever, daemon=True).start()
        self._stack.callback(server.shutdown)
        own_uri = f"http://127.0.0.1:{server.server_address[1]}/"
        master(self.beyond).registerPublisher(name, topic, "std_msgs/String", own_uri)

    def listen(self, way: str, topic: str, seconds: float) -> dict[str, float]:
        """What a listener receives in so many seconds, and the CPU time for each message."""
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


def _retry(what: str) -> Iterator[None]:
    give_up = time.monotonic() + _PATIENCE
    while time.monotonic() < give_up:
        yield
        time.sleep(0.05)
    raise TimeoutError(f"{what} does not start")


def _reached(port: int) -> None:
    """Wait until the port is open."""
    for _ in _retry("a master"):
        with socket.socket() as sock:
            if sock.connect_ex(("127.0.0.1", port)) == 0:
                return


def registered(uri: str, name: str) -> str:
    """Where the slave API of a node is, once that master knows it."""
    address = ""
    for _ in _retry(name):
        code, _, address = master(uri).lookupNode("/bench", name)
        if code == 1:
            break
    return address


def _used(process: int) -> float:
    """Seconds of CPU time, of threads that have ended as well: clock_getcpuclockid(3)."""
    return time.clock_gettime(~process << 3 | 2)


def _certificate(directory: Path) -> None:
    subprocess.run(
        [
            "openssl",
            "req",
            "-x509",
            "-newkey",
            "ec",
            "-pkeyopt",
            "ec_paramgen_curve:P-256",
            "-nodes",
            "-subj",
            "/CN=bench",
            "-keyout",
            f"{directory}/key.pem",
            "-out",
            f"{directory}/cert.pem",
            "-days",
            "2",
        ],
        check=True,
        capture_output=True,
    )
