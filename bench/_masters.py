"""Both masters as processes of their own, and the nodes of a site."""

import contextlib
import os
import secrets
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

from ca.authority import Authority
from ca.certificates import Identity
from ca.keys.private_keys import generate
from ca.keys.signing import KeySigner
from ca.svid import build_request
from grants import document
from grants.model import Draft, Permission, Right
from rossec.channel.edhoc.credentials import Credentials
from rossec.ros.names import MASTER
from tests.support.site import DAY, Site

OWN = Right.PUBLISH | Right.SUBSCRIBE | Right.PROVIDE | Right.PARAM_GET | Right.PARAM_SET
SHARED = Right.SUBSCRIBE | Right.CALL | Right.PARAM_GET | Right.GRAPH


class Master(NamedTuple):
    """A running master."""

    pid: int
    port: int

    def cpu(self) -> float:
        """Seconds of processor time used so far."""
        return time.clock_gettime(~self.pid << 3 | 2)  # clock_getcpuclockid(3)

    def rss(self) -> int:
        """Resident memory, kB."""
        lines = Path(f"/proc/{self.pid}/status").read_text().splitlines()
        return next(int(line.split()[1]) for line in lines if line.startswith("VmRSS"))


class EnrolledNode(NamedTuple):
    """An enrolled node with its grant."""

    name: str
    credentials: Credentials
    identity: Identity
    grant: bytes


def enroll(site: Site, name: str, rights: Mapping[str, Right] | None = None) -> EnrolledNode:
    """A node with all rights in its namespace and read rights to all else, unless `rights` differ.

    Nothing is written.
    """
    held = rights or {f"{name}/**": OWN, "/rosout": OWN, "/**": SHARED}
    authority: Authority = site.authority.authority
    signer, now = KeySigner(generate()), site.now()
    request = build_request(signer, site.anchor.domain, name)
    certificate = authority.issue(request, now=now, serial=secrets.randbits(127), lifetime=DAY)
    identity = site.anchor.verify([certificate], now)
    draft = Draft(
        domain=site.anchor.domain,
        subject=name,
        holder=identity.thumbprint,
        not_before=now - 60,
        expires=now + DAY,
        cap=now + DAY,
        serial=secrets.token_bytes(16),
        permissions=tuple(Permission(pattern, right) for pattern, right in held.items()),
    )
    grant = document.sign(site.authority.signer, draft)
    return EnrolledNode(name, Credentials(signer, (certificate,)), identity, grant)


def free_port() -> int:
    """A port of 127.0.0.1 that nothing listens on."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port: int = free.getsockname()[1]
        return port


@contextlib.contextmanager
def running(command: list[str], environ: dict[str, str], port: int) -> Iterator[Master]:
    """A command that listens on `port`, from when it does."""
    base = {key: value for key, value in os.environ.items() if not key.startswith("ROS")}
    process = subprocess.Popen(
        command, env={**base, **environ}, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL
    )
    try:
        end = time.monotonic() + 30
        while time.monotonic() < end and process.poll() is None:
            with socket.socket() as probe:
                if probe.connect_ex(("127.0.0.1", port)) == 0:
                    break
            time.sleep(0.05)
        yield Master(process.pid, port)
    finally:
        process.kill()
        process.wait()


@contextlib.contextmanager
def stock(folder: Path) -> Iterator[Master]:
    """Debian's rosmaster, plain."""
    port = free_port()
    environ = {
        "ROS_MASTER_URI": f"http://127.0.0.1:{port}/",
        "ROS_IP": "127.0.0.1",
        "ROS_HOME": str(folder),
        "ROS_LOG_DIR": str(folder),
    }
    with running(["/usr/bin/rosmaster", "--core", "-p", str(port)], environ, port) as master:
        yield master


@contextlib.contextmanager
def ours(site: Site) -> Iterator[Master]:
    """`rossec master`, as it is installed."""
    port = free_port()
    site.enroll(MASTER)
    site.enroll(MASTER).save_revocations(site.authority.store.newest_list() or b"")
    environ = {
        "ROS_MASTER_URI": f"http://127.0.0.1:{port}/",
        "ROS_IP": "127.0.0.1",
        "ROSSEC_HOME": str(site.root),
    }
    command = [sys.executable, "-I", "-m", "rossec", "master"]
    with running(command, environ, port) as master:
        yield master
