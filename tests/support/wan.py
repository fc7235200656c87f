"""Sites behind NAT and routers in the open, for a test: namespaces, loss, delay, captured packets.

Every site is a private network of its own behind a gateway that masquerades (nftables) and lets
in only answers; all have the same addresses, as homes have. In the open are the routers. Frames
between sites and routers pass `tests.support.slowline` if they are to be delayed.
"""

import asyncio
import contextlib
import os
import subprocess
import sys
from collections.abc import AsyncIterator, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import pytest

from tests.support.hosts import Host, holder, packets_of
from tests.support.recorder import Recording
from tests.support.stock import process
from tests.support.witness import until

_OPEN: Final = "203.0.113"  # documentation addresses (RFC 5737): routers from .10, gateways from .100
_PRIVATE: Final = "192.168.1"  # of each site: hosts from .10, the gateway is .1
_FIREWALL: Final = """
table ip gateway {
    chain leaving { type nat hook postrouting priority srcnat; oifname "wan" masquerade; }
    chain lossy { type filter hook forward priority -10; }
    chain entering {
        type filter hook forward priority 0; policy drop;
        ct state established,related accept
        iifname "lan" accept
    }
}
"""


@dataclass(frozen=True)
class Wan:
    """The hosts of all sites and the routers, by their names."""

    hosts: Mapping[str, Host]
    _open: tuple[str, ...] = ()
    _gateways: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    _ports: Mapping[str, str] = field(default_factory=dict)

    def __getitem__(self, name: str) -> Host:
        return self.hosts[name]

    @contextlib.contextmanager
    def lossy(self, one_of: int) -> Iterator[None]:
        """Meanwhile each gateway drops one packet of so many, either way; see `losing`."""
        for gateway in self._gateways.values():
            _nft(gateway, f"add rule ip gateway lossy {losing(one_of)}")
        try:
            yield
        finally:
            for gateway in self._gateways.values():
                _nft(gateway, "flush chain ip gateway lossy")

    @contextlib.contextmanager
    def without(self, site: str) -> Iterator[None]:
        """Meanwhile no packet passes between a site and the open, and nobody is told."""
        _run(self._open, "bridge", "link", "set", "dev", self._ports[site], "state", "0")
        try:
            yield
        finally:
            _run(self._open, "bridge", "link", "set", "dev", self._ports[site], "state", "3")

    @contextlib.asynccontextmanager
    async def recorded(self, file: Path) -> AsyncIterator[list[Recording]]:
        """Record every frame from and to a router meanwhile; afterwards the list has it."""
        found: list[Recording] = []
        command = ("tcpdump", "-i", "routers", "--immediate-mode", "-s", "0", "-U", "-w", str(file))
        async with process(dict(os.environ), *self._open, *command) as running:
            await until(lambda: file.exists() and file.stat().st_size >= 24, within=20)
            yield found
            await asyncio.sleep(0.2)  # what it was given and has not read is lost at its end
            running.terminate()
            said, _ = await asyncio.wait_for(running.communicate(), 20)
        found.append(packets_of(file, said))


def losing(one_of: int) -> str:
    """The rule of nftables that drops five packets of each `5 * one_of + 2`, two of them in a row.

    Not at random: a request all of whose tries are lost is given up after 93 s (RFC 7252 section
    4.8.2), so that one run in thirty would say nothing of the program. The distances differ: what
    is sent in a fixed order does not lose the same packet each time.
    """
    places = (1, 2, one_of + 3, 2 * one_of + 4, 4 * one_of)
    drops = ", ".join(f"{place} : drop" for place in places)
    return f"numgen inc mod {5 * one_of + 2} vmap {{ {drops} }}"


@contextlib.contextmanager
def wan_of(
    sites: Mapping[str, Sequence[str]], routers: Sequence[str], *, delay_ms: float = 0
) -> Iterator[Wan]:
    """Create the hosts of each site, and the routers; remove them afterwards.

    Args:
        delay_ms: how long each frame takes between a site and a router, each way.
    """
    with contextlib.ExitStack() as stack:
        try:
            wan = _Builder(stack).build(sites, routers, delay_ms)
        except (OSError, subprocess.CalledProcessError) as error:
            if os.environ.get("CI"):  # there they must be: a broken set-up is no skip
                raise
            pytest.skip(f"NOT RUN: needs network namespaces and nftables: {error}")
        yield wan


class _Builder:
    """Makes namespaces, which end with `stack`."""

    def __init__(self, stack: contextlib.ExitStack) -> None:
        self._stack = stack
        self._mapped = () if os.geteuid() == 0 else ("--map-root-user",)
        self._mine = () if os.geteuid() == 0 else ("--user", "--preserve-credentials")
        self._first: tuple[str, ...] = ()

    def build(self, sites: Mapping[str, Sequence[str]], routers: Sequence[str], delay_ms: float) -> Wan:
        self._first = backbone = self._namespace()[1]
        _ip(
            backbone,
            [
                line
                for name in ("sites", "routers")
                for line in (f"link add {name} type bridge mcast_snooping 0", f"link set {name} up")
            ],
        )
        self._join_bridges(delay_ms)
        hosts = {
            name: self._host(backbone, "routers", f"router{number}", f"{_OPEN}.{10 + number}")
            for number, name in enumerate(routers)
        }
        gateways, ports = {}, {}
        for number, (site, names) in enumerate(sites.items()):
            ports[site] = f"site{number}"
            gateway = gateways[site] = self._gateway(number, ports[site])
            for place, name in enumerate(names):
                hosts[name] = self._host(
                    gateway, "lan", f"host{place}", f"{_PRIVATE}.{10 + place}", f"{_PRIVATE}.1"
                )
        return Wan(hosts, backbone, gateways, ports)

    def _join_bridges(self, delay_ms: float) -> None:
        backbone = self._first
        if not delay_ms:
            _ip(
                backbone,
                [
                    "link add trunk0 type veth peer name trunk1",
                    "link set trunk0 master sites",
                    "link set trunk1 master routers",
                    "link set trunk0 up",
                    "link set trunk1 up",
                ],
            )
            return
        slow = (sys.executable, "-m", "tests.support.slowline", str(delay_ms), "tap0", "tap1")
        line = subprocess.Popen([*backbone, *slow], stdout=subprocess.PIPE, text=True)
        self._stack.enter_context(line)
        self._stack.callback(line.kill)
        assert line.stdout is not None
        if not line.stdout.readline():
            raise subprocess.CalledProcessError(line.wait(), "slowline")
        _ip(
            backbone,
            [
                "link set tap0 master sites",
                "link set tap1 master routers",
                "link set tap0 up",
                "link set tap1 up",
            ],
        )

    def _gateway(self, number: int, port: str) -> tuple[str, ...]:
        pid, inside = self._namespace()
        _ip(
            self._first,
            [
                f"link add {port} type veth peer name wan netns {pid}",
                f"link set {port} master sites",
                f"link set {port} up",
            ],
        )
        _ip(
            inside,
            [
                f"addr add {_OPEN}.{100 + number}/24 dev wan",
                "link set wan up",
                "link set lo up",
                "link add lan type bridge mcast_snooping 0",
                f"addr add {_PRIVATE}.1/24 dev lan",
                "link set lan up",
            ],
        )
        _run(inside, "sysctl", "-qw", "net.ipv4.ip_forward=1")
        _nft(inside, _FIREWALL)
        return inside

    def _host(self, switch: tuple[str, ...], bridge: str, port: str, address: str, gateway: str = "") -> Host:
        pid, inside = self._namespace()
        _ip(
            switch,
            [
                f"link add {port} type veth peer name eth0 netns {pid}",
                f"link set {port} master {bridge}",
                f"link set {port} up",
            ],
        )
        route = [f"route add default via {gateway}"] if gateway else []
        _ip(inside, [f"addr add {address}/24 dev eth0", "link set eth0 up", "link set lo up", *route])
        return Host(inside, address, "")

    def _namespace(self) -> tuple[int, tuple[str, ...]]:
        """A new one, inside of the first; its holder and how a command gets there."""
        prefix = self._first or ()
        unshare = ("unshare", "--net") if prefix else ("unshare", *self._mapped, "--net")
        pid = self._stack.enter_context(holder((*prefix, *unshare)))
        return pid, ("nsenter", "--target", str(pid), *self._mine, "--net")


def _ip(where: tuple[str, ...], commands: Sequence[str]) -> None:
    _run(where, "ip", "-batch", "-", told="\n".join(commands))


def _nft(where: tuple[str, ...], rules: str) -> None:
    _run(where, "nft", "-f", "-", told=rules)


def _run(where: tuple[str, ...], *command: str, told: str = "") -> None:
    path = {"PATH": f"{os.environ['PATH']}:/usr/sbin:/sbin"}
    subprocess.run(
        [*where, *command], input=told, text=True, check=True, capture_output=True, env={**os.environ, **path}
    )
