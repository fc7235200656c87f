"""The thesis's test bed as network namespaces: hosts on a switch, links with a rate, bytes counted.

One host has one clock, so that a message's time of arrival can be compared with its time of sending
without the digital outputs and the logic analyzer of the thesis. A rate is that of a token bucket
(`tbf`) at both ends of a link, which also bounds how much may wait: what is more is lost.
"""

import contextlib
import json
import subprocess
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final

from tests.support.hosts import Host
from tests.support.lan import Lan, lan_of

ETHERNET: Final = 100_000  # kbit/s
RADIO: Final = 300
_QUEUE: Final = 100_000  # bytes that may wait for a link
_FRAME: Final = 1600


def burst(kbit: int) -> int:
    """Bytes that may leave at once: 1 ms of the rate, and at least two frames."""
    return max(2 * _FRAME, kbit // 8)


def shaped(device: str, kbit: int) -> str:
    """The arguments of `tc` that give a device its rate."""
    return f"qdisc replace dev {device} root tbf rate {kbit}kbit burst {burst(kbit)} limit {_QUEUE}"


class NoNamespaces(Exception):
    """This machine permits no network namespaces, or has no `tc`."""


@dataclass(frozen=True)
class Device:
    """One end of a link, whose bytes are counted."""

    host: Host
    name: str

    def counters(self) -> tuple[int, int]:
        """Bytes received and sent so far."""
        said = _run(self.host.at("ip", "-s", "-j", "link", "show", "dev", self.name))
        found: dict[str, Any] = json.loads(said)[0]["stats64"]
        return found["rx"]["bytes"], found["tx"]["bytes"]


class Testbed:
    """Hosts on one switch, each at its port; and lines that join two of them."""

    def __init__(self, lan: Lan) -> None:
        self._lan = lan
        self._lines = 0

    def __getitem__(self, name: str) -> Host:
        return self._lan[name]

    def limit(self, name: str, kbit: int) -> Device:
        """Give the link between a host and the switch a rate; the host's end of it."""
        _run((*self._lan.switch, "tc", *shaped(self._lan.ports[name], kbit).split()))
        device = Device(self[name], "eth0")
        _run(self[name].at("tc", *shaped(device.name, kbit).split()))
        return device

    def line(self, one: str, other: str, kbit: int) -> tuple[Device, str]:
        """Join two hosts by a link of their own: the end at `other`, and the address of `one`."""
        self._lines += 1
        net, device = f"10.97.{self._lines}", f"line{self._lines}"
        inside = self[other].prefix[self[other].prefix.index("--target") + 1]
        peer = ("type", "veth", "peer", "name", device, "netns", inside)
        _run(self[one].at("ip", "link", "add", device, *peer))
        for number, name in enumerate((one, other), 1):
            _run(self[name].at("ip", "addr", "add", f"{net}.{number}/24", "dev", device))
            _run(self[name].at("ip", "link", "set", device, "up"))
            _run(self[name].at("tc", *shaped(device, kbit).split()))
        return Device(self[other], device), f"{net}.1"

    def through(self, line: Device, router: str, far: str, host: str) -> None:
        """Lead what a host behind a line and one of this site send each other over it.

        Args:
            line: the end of the line at the far host.
            router: the host at its other end.
            far: the address of that end.
            host: of the router's site.
        """
        net = far.rpartition(".")[0]
        _run(self[router].at("sysctl", "-qw", "net.ipv4.ip_forward=1"))
        _run(line.host.at("ip", "route", "add", self[host].ipv4, "via", far, "dev", line.name))
        back = ("ip", "route", "add", f"{net}.0/24", "via", self[router].ipv4)
        _run(self[host].at(*back))


@contextlib.contextmanager
def network_of(names: Sequence[str], kbit: int = ETHERNET) -> Iterator[Testbed]:
    """Hosts on a switch, whose links have a rate.

    Raises:
        NoNamespaces: it cannot be made here.
    """
    with lan_of({"switch": names}) as lan:
        if not lan.real:
            raise NoNamespaces("network namespaces are not permitted here")
        network = Testbed(lan)
        for name in names:
            network.limit(name, kbit)
        yield network


def _run(command: Sequence[str]) -> str:
    try:
        done = subprocess.run(command, check=True, capture_output=True, text=True)
    except (OSError, subprocess.CalledProcessError) as error:
        raise NoNamespaces(f"{' '.join(command)}: {getattr(error, 'stderr', error)}") from error
    return done.stdout
