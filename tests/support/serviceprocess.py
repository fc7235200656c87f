"""`rossec ca serve` as a separate process, and the commands that use it."""

import os
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

from rossec.authority.home import AuthorityHome
from rossec.authority.keyservice.client import KeyServiceClient
from rossec.home import NodeHome
from tests.support.commands import PASSPHRASE


class ServiceProcess:
    """An authority with `/master` below `root`, and its service; ended by `close`.

    Args:
        root: ROSSEC_HOME.
        begun: when the authority was made, and `/master` enrolled for 30 days; 0: now.
    """

    def __init__(self, root: Path, begun: int = 0) -> None:
        root.mkdir(mode=0o700, parents=True, exist_ok=True)
        self.root, self.directory = root, root / "ca"
        self.secret = root / "passphrase"
        self.secret.write_text(PASSPHRASE + "\n")
        self.secret.chmod(0o600)
        base = {key: value for key, value in os.environ.items() if not key.startswith("ROS")}
        self.environ = {**base, "ROSSEC_HOME": str(root), "ROS_IP": "127.0.0.1"}
        self.environ["ROS_MASTER_URI"] = "http://127.0.0.1:1/"
        self.process: subprocess.Popen[str] | None = None
        if begun:
            self._make(begun)
        else:
            self.run("ca", "init", "home", "--master", "--passphrase-file", str(self.secret))

    def _make(self, begun: int) -> None:
        home = AuthorityHome.create(self.root, "home", PASSPHRASE, begun)
        master = NodeHome.of(self.root, "/master")
        master.create_request("home")
        authority = home.unlock(PASSPHRASE)
        with closing(authority.store):
            master.install(authority.issue(master.request(), begun), begun)

    @property
    def home(self) -> AuthorityHome:
        return AuthorityHome(self.directory)

    @property
    def pid(self) -> int:
        assert self.process is not None
        return self.process.pid

    def run(self, *arguments: str, check: bool = True) -> subprocess.CompletedProcess[str]:
        """Run a command without a terminal: it can ask nobody for a passphrase."""
        done = subprocess.run(
            [sys.executable, "-I", "-m", "rossec", *arguments],
            env=self.environ,
            text=True,
            capture_output=True,
            stdin=subprocess.DEVNULL,
            timeout=60,
            check=False,
        )
        assert "Traceback" not in done.stderr, done.stderr
        assert not check or done.returncode == 0, done.stderr
        return done

    def start(self, *options: str) -> str:
        """Run the service until it is ready; returns what it says then."""
        given = ("--passphrase-file", str(self.secret), "--json", *options)
        self.process = subprocess.Popen(
            [sys.executable, "-I", "-m", "rossec", "ca", "serve", *given],
            env=self.environ,
            text=True,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
        )
        assert self.process.stdout is not None
        return self.process.stdout.readline()

    def client(self) -> KeyServiceClient:
        client = KeyServiceClient.find(self.directory)
        assert client is not None
        return client

    def audit(self) -> str:
        return (self.directory / "audit.log").read_text()

    def kill(self) -> None:
        """As `kill -9`."""
        assert self.process is not None
        self.process.kill()
        self._reap()

    def terminate(self) -> int:
        """Send SIGTERM, as a service manager does; the exit code."""
        assert self.process is not None
        self.process.terminate()
        return self._reap()

    def close(self) -> None:
        if self.process is not None and self.process.poll() is None:
            self.kill()

    def _reap(self) -> int:
        assert self.process is not None
        assert self.process.stdout is not None
        code = self.process.wait(30)
        self.process.stdout.close()
        return code


def children_of(pid: int) -> list[int]:
    """The processes that a process started and that still run."""
    text = Path(f"/proc/{pid}/task/{pid}/children").read_text()
    return [int(child) for child in text.split()]


def wait_until_gone(pid: int, within: float = 10) -> None:
    """Wait until a process has ended."""
    end = time.monotonic() + within
    while Path(f"/proc/{pid}").exists():
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
        if state == "Z":
            return
        assert time.monotonic() < end, "it still runs"
        time.sleep(0.05)
