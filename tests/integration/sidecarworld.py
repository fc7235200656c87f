"""Two hosts, a secured master on the first, and Debian's programs behind sidecars on both.

No part is simulated: `rossec master` and `rossec run` are started as a user starts them.
"""

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from grants.model import Right
from rossec.host.callers import descendants, parents
from rossec.ros.names import MASTER
from tests.support.hosts import Host, Hosts
from tests.support.ports import free_port
from tests.support.site import DAY, Site

ROSSEC: Final = str(Path(sys.executable).parent / "rossec")
DEADLINE: Final = 40.0


class Running:
    """A running program and its output so far; stdout and stderr are merged."""

    def __init__(self, command: tuple[str, ...], env: dict[str, str]) -> None:
        self.process = subprocess.Popen(
            command,
            env=env,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )
        self.lines: list[str] = []
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        self.lines.extend(self.process.stdout)

    @property
    def said(self) -> str:
        return "".join(self.lines)

    def wait_for(self, words: str) -> None:
        wait(lambda: words in self.said or self.process.poll() is not None)
        assert words in self.said, self.said

    def end(self, number: signal.Signals = signal.SIGTERM) -> int:
        """Send a signal to this process alone; return its exit code."""
        self.process.send_signal(number)
        return self.process.wait(DEADLINE)

    def close(self) -> None:
        """Kill it and all its descendants, in any session: roslaunch makes one for each."""
        for process in (self.process.pid, *descendants(parents(), self.process.pid)):
            with contextlib.suppress(ProcessLookupError):
                os.kill(process, signal.SIGKILL)
        self.process.wait()
        self._reader.join()
        assert self.process.stdout is not None
        self.process.stdout.close()


@dataclass
class World:
    """The hosts, the trust domain, and methods to start programs there."""

    hosts: Hosts
    site: Site
    directory: Path
    port: int = field(default_factory=free_port)
    ipv6: bool = False
    home: Path | None = None  # the master's home, if not the site's

    def env(self, host: Host) -> dict[str, str]:
        kept = {key: value for key, value in os.environ.items() if not key.startswith("ROS")}
        near, own = self.hosts.near, host.ipv6 if self.ipv6 else host.ipv4
        master = f"[{near.ipv6}]" if self.ipv6 else near.ipv4
        return {
            **kept,
            "ROSSEC_HOME": str(self.site.root),
            "ROS_IP": own,
            "ROS_IPV6": "on" if self.ipv6 else "off",
            "ROS_MASTER_URI": f"http://{master}:{self.port}/",
            "ROS_HOME": str(self.directory),
            "ROS_LOG_DIR": str(self.directory),
            "PYTHONUNBUFFERED": "1",
            "PYTHONWARNINGS": "ignore",
        }

    @contextlib.contextmanager
    def started(self, host: Host, *command: str) -> Iterator[Running]:
        """`command` on `host`, without a sidecar."""
        running = Running(host.at(*command), self.env(host))
        try:
            yield running
        finally:
            running.close()

    @contextlib.contextmanager
    def master(self, *options: str) -> Iterator[Running]:
        newest = self.site.authority.store.newest_list()
        assert newest is not None
        self.site.enroll(MASTER).save_revocations(newest)
        if self.home is not None:
            shutil.copytree(self.site.root, self.home)
        command = "env", f"ROSSEC_HOME={self.home or self.site.root}", ROSSEC, "master"
        with self.started(self.hosts.near, *command, "-p", str(self.port), *options) as running:
            running.wait_for(f"master of {self.site.anchor.domain} at")
            yield running

    def secured(
        self, host: Host, *command: str, options: tuple[str, ...] = ()
    ) -> "contextlib.AbstractContextManager[Running]":
        """`command` on `host` behind a sidecar of its own."""
        return self.started(host, ROSSEC, "run", *options, "--", *command)

    def run(
        self, host: Host, *command: str, options: tuple[str, ...] = ()
    ) -> subprocess.CompletedProcess[str]:
        """`command` on `host` behind a sidecar of its own, to its end."""
        try:
            return subprocess.run(
                host.at(ROSSEC, "run", *options, "--", *command),
                env=self.env(host),
                text=True,
                capture_output=True,
                timeout=DEADLINE,
                check=False,
            )
        except subprocess.TimeoutExpired as late:
            said = b"".join(part for part in (late.stdout, late.stderr) if isinstance(part, bytes))
            raise AssertionError(f"{command} does not end: {said.decode()}") from None

    def tool(self, *command: str, options: tuple[str, ...] = ()) -> str:
        """The output of a tool that is run on the other host and succeeds."""
        done = self.run(self.hosts.far, *command, options=options)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    def enroll(self, name: str, *, wildcard: bool = False, lifetime: int = DAY, **rights: str) -> None:
        """Enroll a program with the rights every ROS node needs, and more: `publish="/a /b"`."""
        self.site.enroll(name, lifetime, wildcard=wildcard)
        self.site.publish(name, "/rosout")
        own = f"{name}~" if wildcard else name
        self.site.grant(name, Right.PROVIDE, f"{own}/get_loggers")
        self.site.grant(name, Right.PROVIDE, f"{own}/set_logger_level")
        self.site.grant(name, Right.PARAM_GET, "/**")
        for right, patterns in rights.items():
            for pattern in patterns.split():
                self.site.grant(name, Right[right.upper()], pattern)


def wait(holds: Callable[[], object], within: float = DEADLINE) -> None:
    """Wait for a state that has no notification."""
    end = time.monotonic() + within
    while not holds():
        assert time.monotonic() < end, "it did not come to hold in time"
        time.sleep(0.02)
