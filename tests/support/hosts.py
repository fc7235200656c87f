"""Two hosts for a test: network namespaces joined by a link, IPv4 and IPv6, recorded if wanted.

Where namespaces are not permitted the hosts are two loopback addresses, and `Hosts.real` is false;
programs are then separated only by their addresses.
"""

import asyncio
import contextlib
import os
import re
import struct
import subprocess
from collections.abc import AsyncIterator, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from tests.support.recorder import Recording
from tests.support.stock import process
from tests.support.witness import until

_LINK: Final = "rossec0"
_MAPPED: Final = ("--map-root-user",)
_MINE: Final = ("--user", "--preserve-credentials")


@dataclass(frozen=True)
class Host:
    """One host: its addresses, and the prefix of commands run there."""

    prefix: tuple[str, ...]
    ipv4: str
    ipv6: str

    def at(self, *command: str) -> tuple[str, ...]:
        """`command`, to be run on this host."""
        return (*self.prefix, *command)


@dataclass(frozen=True)
class Hosts:
    """Both hosts; `real` if they have network namespaces."""

    near: Host
    far: Host
    real: bool

    @contextlib.asynccontextmanager
    async def recorded(self, file: Path) -> AsyncIterator[list[Recording]]:
        """Record the link meanwhile; afterwards the list contains the recording."""
        found: list[Recording] = []
        env = dict(os.environ)
        command = ("tcpdump", "-i", _LINK, "-s", "0", "-U", "-B", "65536", "-w", str(file))
        async with process(env, *self.near.at(*command)) as running:
            await until(lambda: file.exists() and file.stat().st_size >= 24, within=20)
            yield found
            running.terminate()
            said, _ = await asyncio.wait_for(running.communicate(), 20)
        found.append(packets_of(file, said))


@contextlib.contextmanager
def two_hosts() -> Iterator[Hosts]:
    """Create both, and remove them afterwards."""
    mapped = () if os.geteuid() == 0 else _MAPPED
    mine = () if os.geteuid() == 0 else _MINE
    with contextlib.ExitStack() as stack:
        try:
            near = stack.enter_context(holder(("unshare", *mapped, "--net")))
            inside = ("nsenter", "--target", str(near), *mine, "--net")
            far = stack.enter_context(holder((*inside, "unshare", "--net")))
            beyond = ("nsenter", "--target", str(far), *mine, "--net")
            _join(inside, beyond, far)
        except (OSError, subprocess.CalledProcessError):
            yield Hosts(Host((), "127.0.0.1", "::1"), Host((), "127.0.0.2", "::1"), real=False)
            return
        yield Hosts(Host(inside, "10.99.0.1", "fd99::1"), Host(beyond, "10.99.0.2", "fd99::2"), real=True)


@contextlib.contextmanager
def holder(isolation: tuple[str, ...]) -> Iterator[int]:
    """A process that keeps a namespace alive; its id."""
    # The echo runs inside: once it is read the namespace exists.
    holder = subprocess.Popen(
        [*isolation, "sh", "-c", "echo $$; exec sleep infinity"], stdout=subprocess.PIPE, text=True
    )
    try:
        with holder:
            assert holder.stdout is not None
            line = holder.stdout.readline()
            if not line:
                raise subprocess.CalledProcessError(holder.wait(), isolation)
            try:
                yield int(line)
            finally:
                holder.kill()
    finally:
        holder.kill()


def _join(near: tuple[str, ...], far: tuple[str, ...], far_pid: int) -> None:
    def ip(host: tuple[str, ...], words: str) -> None:
        subprocess.run([*host, "ip", *words.split()], check=True, capture_output=True)

    ip(near, f"link add {_LINK} type veth peer name {_LINK} netns {far_pid}")
    for host, number in ((near, 1), (far, 2)):
        ip(host, f"addr add 10.99.0.{number}/24 dev {_LINK}")
        ip(host, f"addr add fd99::{number}/64 dev {_LINK} nodad")
        ip(host, f"link set {_LINK} up")
        ip(host, "link set lo up")


def packets_of(file: Path, said: bytes) -> Recording:
    """What tcpdump recorded into `file`; `said`: what it printed at its end."""
    dropped = re.search(rb"(\d+) packets? dropped by kernel", said)
    return Recording(list(_packets(file)), int(dropped[1]) if dropped else -1)


def _packets(file: Path) -> Iterator[bytes]:
    """The packets of a capture in tcpdump's own format."""
    data = file.read_bytes()
    order = "<" if data[:4] == b"\xd4\xc3\xb2\xa1" else ">"
    position = 24
    while position + 16 <= len(data):
        (length,) = struct.unpack_from(f"{order}I", data, position + 8)
        position += 16
        yield data[position : position + length]
        position += length
