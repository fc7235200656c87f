"""A console and what it works with, as processes: authority, master, nodes; one ROSSEC_HOME."""

import contextlib
import io
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Final

from rossec.cli.main import run
from tests.support.commands import PASSPHRASE
from tests.support.ports import free_port

POSE: Final = "/robot/pose"
SCAN: Final = "/robot/scan"
CAMERA: Final = "/robot/camera"
_TYPES: Final = {
    POSE: "geometry_msgs/PoseStamped",
    SCAN: "sensor_msgs/LaserScan",
    CAMERA: "sensor_msgs/Image",
}
# Everything is asked; a coarser answer is possible, since the types are known.
ASKED: Final = """
rossec: 1
robot: the robot at home
defaults: {decision: prompt, prompt_timeout: 10m, lifetime: 7d}
types: {/robot/pose: geometry_msgs/PoseStamped, /robot/scan: sensor_msgs/LaserScan}
rules: []
"""
_WAIT_S: Final = 40.0
_SHORT_CODES: Final = """import sys
from rossec.authority.console import access
from rossec.cli.main import main
access.CODE_LIFETIME = {}
main()
"""


class Program:
    """A process whose output goes to a file."""

    def __init__(self, log: Path, environ: Mapping[str, str], *arguments: str) -> None:
        self.log = log
        self._seen = 0
        with log.open("ab") as out:
            self.process = subprocess.Popen(
                [sys.executable, "-I", *arguments],
                env=dict(environ),
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=out,
                start_new_session=True,
            )

    def said(self, pattern: str, within: float = _WAIT_S) -> re.Match[str]:
        """Wait for the next output that matches, and return it."""
        end = time.monotonic() + within
        while True:
            text = self.log.read_text(errors="replace")
            if found := re.compile(pattern, re.MULTILINE).search(text, self._seen):
                self._seen = found.end()
                return found
            assert self.process.poll() is None or time.monotonic() < end - within + 1, text
            assert time.monotonic() < end, text
            time.sleep(0.02)

    def ended(self, within: float = _WAIT_S) -> int:
        """Wait until it has ended by itself; its exit code."""
        return self.process.wait(within)

    def stop(self) -> None:
        """End it as a service manager does, then as `kill -9`, with all that it started."""
        if self.process.poll() is None:
            self.process.terminate()
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.process.wait(5)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()


class ConsoleSite:
    """One ROSSEC_HOME with an authority, a master, nodes and a console; `start` runs them."""

    def __init__(self, root: Path, domain: str = "home") -> None:
        root.mkdir(mode=0o700, parents=True, exist_ok=True)
        self.root, self.domain = root, domain
        self.secret = root / "passphrase"
        self.secret.touch(0o600)
        self.secret.write_text(PASSPHRASE + "\n")
        self.key = ("--passphrase-file", str(self.secret))
        self.join_address = f"127.0.0.1:{free_port()}"
        self.port, self.master_port = free_port(), free_port()
        base = {k: v for k, v in os.environ.items() if not k.startswith("ROS")}
        self.environ = {**base, "ROSSEC_HOME": str(root), "ROS_IP": "127.0.0.1"}
        self.environ["ROS_MASTER_URI"] = f"http://127.0.0.1:{self.master_port}/"
        self.programs: list[Program] = []
        # A thread of their own: playwright's loop runs in the thread of the tests.
        self._commands = ThreadPoolExecutor(1)

    @property
    def origin(self) -> str:
        return f"http://localhost:{self.port}"

    def elsewhere(self, name: str) -> Mapping[str, str]:
        """The environment of another computer, with a ROSSEC_HOME of its own."""
        home = self.root / "elsewhere" / name
        home.mkdir(mode=0o700, parents=True, exist_ok=True)
        return {**self.environ, "ROSSEC_HOME": str(home)}

    def run(self, *words: str, environ: Mapping[str, str] | None = None, code: int = 0) -> str:
        """Run `rossec WORDS` in this process; what it printed."""
        given = dict(self.environ if environ is None else environ)
        found, said = self._commands.submit(_run, words, given).result(90)
        assert found == code, said
        assert "Traceback" not in said, said
        return said

    def begin(self, module: str, *arguments: str, log: str, **variables: str) -> Program:
        """Start `python -m MODULE ARGUMENTS`."""
        return self._start("-m", module, *arguments, log=log, **variables)

    def _start(self, *arguments: str, log: str, **variables: str) -> Program:
        logs = self.root / "logs"
        logs.mkdir(mode=0o700, exist_ok=True)
        environ = {**self.environ, **variables}
        program = Program(logs / f"{log}.log", environ, *arguments)
        self.programs.append(program)
        return program

    def enroll(self, *names: str) -> None:
        """Identities from a file, as `rossec ca sign` gives them."""
        for name in names:
            self.run("node", "request", name)
        requests = [str(self.node(name) / "node.csr") for name in names]
        self.run("ca", "sign", *requests, "--yes", *self.key)
        for name in names:
            self.run("node", "install", str(self.node(name) / "node.pem"), "--yes")

    def node(self, name: str) -> Path:
        """The directory of a node."""
        return self.root / "nodes" / name.lstrip("/").replace("/", ".")

    def grant(self, node: str, *permissions: str) -> None:
        """Sign a grant for a day, without a person."""
        self.run("grant", "sign", node, *permissions, "--for", "1d", *self.key)

    def write_policy(self, text: str) -> None:
        """Have the authority's policy say this."""
        path = self.root / "ca" / "policy.yaml"
        path.touch(0o600)
        path.write_text(text)

    def start_authority(self, *options: str, code_lifetime: float = 0) -> Program:
        """Run `rossec ca serve`; its codes last `code_lifetime` seconds (0: as always)."""
        given = ("--join-address", self.join_address, *(options or ("--unlock-for", "0")))
        how = ("-c", _SHORT_CODES.format(code_lifetime)) if code_lifetime else ("-m", "rossec")
        self.authority = self._start(*how, "ca", "serve", "--json", *self.key, *given, log="authority")
        self.authority.said(r"^\{.*\}$")
        return self.authority

    def start_master(self) -> Program:
        """Run `rossec master`, where the others look for it."""
        port = str(self.master_port)
        self.master = self.begin("rossec", "master", "--port", port, "--json", log="master")
        self.master.said(r'"ready"')
        return self.master

    def start_robot(self) -> Program:
        """A robot that drives a circle, and sends its place, a scan and a picture."""
        robot = self.begin("rossec.demo.robot", log="robot")
        robot.said(r'"ready"')
        return robot

    def start_receiver(self, name: str, *topics: str) -> Program:
        """A node that receives topics of the robot."""
        wanted = [f"{topic}={_TYPES[topic]}" for topic in topics]
        return self.begin("rossec.demo.subscriber", name, *wanted, log=name.strip("/"))

    def start_console(self, *options: str) -> Program:
        """Run `rossec console`, and wait until it listens."""
        self.console = self.begin("rossec", "console", "--port", str(self.port), *options, log="console")
        self.console.said(re.escape(self.origin))
        return self.console

    def close(self) -> None:
        """End everything, last first."""
        for program in reversed(self.programs):
            program.stop()
        self._commands.shutdown()


def _run(words: Sequence[str], environ: dict[str, str]) -> tuple[int, str]:
    out = io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
        code = run(list(words), environ)
    return code, out.getvalue()


@contextlib.contextmanager
def console_site(root: Path) -> Iterator[ConsoleSite]:
    """A site with `/master`, a robot and two who look; nothing runs yet."""
    site = ConsoleSite(root)
    try:
        site.run("ca", "init", site.domain, "--master", *site.key)
        yield site
    finally:
        site.close()


def with_robot(site: ConsoleSite) -> None:
    """The demo's three nodes with their grants, all running; the authority runs already."""
    site.enroll("/robot", "/doctor", "/heating")
    site.grant("/robot", *(word for topic in _TYPES for word in ("--publish", topic)))
    site.grant("/doctor", "--subscribe", POSE, "--subscribe", SCAN)
    site.grant("/doctor", "--subscribe", CAMERA)
    site.grant(
        "/heating",
        "--subscribe",
        POSE,
        "--type",
        _TYPES[POSE],
        "--round",
        "pose.position=2",
        "--clear",
        "pose.orientation",
        "--clear",
        "header.frame_id",
    )
    site.start_robot()
    doctor = site.start_receiver("/doctor", *_TYPES)
    heating = site.start_receiver("/heating", POSE)
    for receiver, topic in ((doctor, CAMERA), (heating, POSE)):
        receiver.said(f'"topic": "{topic}"')
