"""A network of several hosts for a test: namespaces on switches, links that are cut and healed.

Each segment is a switch with its hosts; a line joins the segments. A cut link loses every packet
and tells nobody, as a line that is cut far away. Where namespaces are not permitted `Lan.real` is
false, the hosts are addresses of loopback, and nothing can be cut.
"""

import contextlib
import os
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from tests.support.hosts import Host, holder

_BLOCKED, _FORWARDING = "0", "3"  # states of a bridge's port (linux/if_bridge.h)


@dataclass(frozen=True)
class Lan:
    """The hosts by their names; `real` if they have network namespaces.

    Attributes:
        switch: the prefix of commands that are run on the switch.
        ports: the switch's device for each host, and for each segment but the first.
    """

    hosts: Mapping[str, Host]
    real: bool
    switch: tuple[str, ...] = ()
    ports: Mapping[str, str] = field(default_factory=dict)

    def __getitem__(self, name: str) -> Host:
        return self.hosts[name]

    def cut(self, *names: str) -> None:
        """No packet passes between a host, or a segment, and all the others any more."""
        self._set(names, _BLOCKED)

    def heal(self, *names: str) -> None:
        """The links are as before."""
        self._set(names, _FORWARDING)

    @contextlib.contextmanager
    def without(self, *names: str) -> Iterator[None]:
        """The links are cut meanwhile."""
        self.cut(*names)
        try:
            yield
        finally:
            self.heal(*names)

    def _set(self, names: Sequence[str], state: str) -> None:
        assert self.real, "without namespaces no link can be cut"
        for name in names:
            command = ("bridge", "link", "set", "dev", self.ports[name], "state", state)
            subprocess.run([*self.switch, *command], check=True, capture_output=True)


@contextlib.contextmanager
def lan_of(segments: Mapping[str, Sequence[str]]) -> Iterator[Lan]:
    """Create segments of hosts, and remove them afterwards; all names differ."""
    names = [host for hosts in segments.values() for host in hosts]
    root = os.geteuid() == 0
    with contextlib.ExitStack() as stack:
        try:
            first = stack.enter_context(holder(("unshare", *(() if root else ("--map-root-user",)), "--net")))
            switch = _enter(first, root=root)
            pids = {name: stack.enter_context(holder((*switch, "unshare", "--net"))) for name in names}
            ports = _join(switch, segments, pids, root=root)
        except (OSError, subprocess.CalledProcessError):
            addresses = {name: Host((), f"127.0.0.{number}", "::1") for number, name in enumerate(names, 1)}
            yield Lan(addresses, real=False)
            return
        hosts = {
            name: Host(_enter(pids[name], root=root), f"10.98.0.{number}", f"fd98::{number}")
            for number, name in enumerate(names, 1)
        }
        yield Lan(hosts, real=True, switch=switch, ports=ports)


def _enter(pid: int, *, root: bool) -> tuple[str, ...]:
    mine = () if root else ("--user", "--preserve-credentials")
    return "nsenter", "--target", str(pid), *mine, "--net"


def _join(
    switch: tuple[str, ...], segments: Mapping[str, Sequence[str]], pids: Mapping[str, int], *, root: bool
) -> dict[str, str]:
    """Wire everything; the switch's port of each host, and of each segment but the first."""
    ports: dict[str, str] = {}
    commands = ["link set lo up"]
    bridges = [f"bridge{number}" for number in range(len(segments))]
    for bridge in bridges:
        commands += [f"link add {bridge} type bridge mcast_snooping 0", f"link set {bridge} up"]
    for number, segment in enumerate(list(segments)[1:], 1):
        ports[segment], near = f"line{number}", f"trunk{number}"
        commands.append(f"link add {ports[segment]} type veth peer name {near}")
        for end, bridge in ((ports[segment], bridges[number]), (near, bridges[0])):
            commands += [f"link set {end} master {bridge}", f"link set {end} up"]
    number = 0
    for bridge, hosts in zip(bridges, segments.values(), strict=True):
        for name in hosts:
            number += 1
            ports[name] = f"port{number}"
            commands += [
                f"link add {ports[name]} type veth peer name eth0 netns {pids[name]}",
                f"link set {ports[name]} master {bridge}",
                f"link set {ports[name]} up",
            ]
    _ip(switch, commands)
    for number, pid in enumerate(pids.values(), 1):
        _ip(
            _enter(pid, root=root),
            [
                f"addr add 10.98.0.{number}/24 dev eth0",
                f"addr add fd98::{number}/64 dev eth0 nodad",
                "link set eth0 up",
                "link set lo up",
            ],
        )
    return ports


def _ip(where: tuple[str, ...], commands: Sequence[str]) -> None:
    subprocess.run(
        [*where, "ip", "-batch", "-"], input="\n".join(commands), text=True, check=True, capture_output=True
    )
