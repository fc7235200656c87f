"""Endpoints, and which door stands for which: the two tables every rewriting goes through. Pure.

A program keeps its loopback port, and gets a door to the network (export); a peer keeps its
address, and gets a door on loopback (import). A program's own URI is given back to it byte for
byte: roscpp compares it so to recognise itself.
"""

from dataclasses import dataclass
from typing import Final

from ca.errors import HintedError
from rossec.channel.opening import Flavour
from rossec.ros.settings import parse_uri

LOOPBACK: Final = "127.0.0.1"
_SCHEMES: Final = {Flavour.HTTP: "http", Flavour.TCPROS: "rosrpc"}


@dataclass(frozen=True)
class Endpoint:
    """Where somebody listens, for XML-RPC (HTTP) or for topics and services (TCPROS)."""

    flavour: Flavour
    host: str
    port: int

    @property
    def uri(self) -> str:
        """As in ROS: `http://host:port/` or `rosrpc://host:port`."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        end = "/" if self.flavour is Flavour.HTTP else ""
        return f"{_SCHEMES[self.flavour]}://{host}:{self.port}{end}"


def inside(flavour: Flavour, port: int) -> Endpoint:
    """The endpoint of a program of this host."""
    return Endpoint(flavour, LOOPBACK, port)


def endpoint(uri: object, flavour: Flavour) -> Endpoint | None:
    """The endpoint a URI names; None: it is not one of this kind."""
    head = f"{_SCHEMES[flavour]}://"
    if not isinstance(uri, str) or not uri.startswith(head):
        return None
    try:
        return Endpoint(flavour, *parse_uri("http://" + uri.removeprefix(head)))
    except HintedError:
        return None


class Doors:
    """The doors of one identity.

    Args:
        host: where peers reach this host.
    """

    def __init__(self, host: str) -> None:
        self.host = host
        self._exported: dict[Endpoint, Endpoint] = {}  # outside -> inside
        self._imported: dict[int, Endpoint] = {}  # loopback port -> remote
        self._spelt: dict[Endpoint, str] = {}

    def opened_outside(self, local: Endpoint, port: int) -> Endpoint:
        """A door to the network for `local`; returns what peers are told."""
        outside = Endpoint(local.flavour, self.host, port)
        self._exported[outside] = local
        return outside

    def opened_inside(self, remote: Endpoint, port: int) -> Endpoint:
        """A loopback door to `remote`; returns what programs are told."""
        self._imported[port] = remote
        return inside(remote.flavour, port)

    def spell(self, local: Endpoint, uri: str) -> None:
        """Remember how a program writes its own URI."""
        self._spelt[local] = uri

    def spelling(self, local: Endpoint) -> str:
        """The program's own URI, byte for byte."""
        return self._spelt.get(local, local.uri)

    def program_behind(self, outside: Endpoint) -> Endpoint | None:
        """The program of this identity that a peer's address leads back to."""
        return self._exported.get(outside)

    def peer_behind(self, local: Endpoint) -> Endpoint | None:
        """The peer a loopback door leads to."""
        found = self._imported.get(local.port)
        return found if found is not None and found.flavour is local.flavour else None
