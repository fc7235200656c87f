"""Endpoints, and which door stands for which: the two tables every rewriting goes through. Pure.

A program keeps its loopback port, and gets a door to the network (export); a peer keeps its
address, and gets a door on loopback (import). A program's own URI is given back to it byte for
byte: roscpp compares it so to recognise itself. An endpoint on this host is its port, whatever host
a program writes; programs are told the one by which they reach loopback.
"""

from dataclasses import dataclass, replace
from typing import Final, NamedTuple

from ca.errors import HintedError
from rossec.channel.opening import WireProtocol
from rossec.ros.settings import parse_uri


class Loopback(NamedTuple):
    """Where programs and their sidecar meet: the address, and how URIs name it."""

    address: str
    host: str


LOOPBACK: Final = Loopback("127.0.0.1", "127.0.0.1")
_SCHEMES: Final = {WireProtocol.HTTP: "http", WireProtocol.TCPROS: "rosrpc"}


@dataclass(frozen=True)
class Endpoint:
    """Where somebody listens, for XML-RPC (HTTP) or for topics and services (TCPROS).

    Attributes:
        asked: `port` is that of a program's slave API, which says where its topics are.
    """

    flavour: WireProtocol
    host: str
    port: int
    asked: bool = False

    @property
    def uri(self) -> str:
        """As in ROS: `http://host:port/` or `rosrpc://host:port`."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        end = "/" if self.flavour is WireProtocol.HTTP else ""
        return f"{_SCHEMES[self.flavour]}://{host}:{self.port}{end}"


def inside(flavour: WireProtocol, port: int) -> Endpoint:
    """The endpoint of a program of this host."""
    return Endpoint(flavour, LOOPBACK.host, port)


def topics_of(api: Endpoint) -> Endpoint:
    """Where the topics of the program with this slave API are: it is asked when somebody comes."""
    return Endpoint(WireProtocol.TCPROS, api.host, api.port, asked=True)


def endpoint(uri: object, flavour: WireProtocol) -> Endpoint | None:
    """The endpoint a URI names; None: it is not one of this kind."""
    head = f"{_SCHEMES[flavour]}://"
    if not isinstance(uri, str) or not uri.startswith(head):
        return None
    try:
        return Endpoint(flavour, *parse_uri("http://" + uri.removeprefix(head)))
    except HintedError:
        return None


class EndpointMap:
    """The doors of one identity.

    Args:
        host: where peers reach this host.
        near: where programs reach it.
    """

    def __init__(self, host: str, near: str = LOOPBACK.host) -> None:
        self.host = host
        self._near = near
        self._exported: dict[Endpoint, Endpoint] = {}  # outside -> inside
        self._imported: dict[int, Endpoint] = {}  # loopback port -> remote
        self._spelt: dict[Endpoint, str] = {}

    def opened_outside(self, local: Endpoint, port: int) -> Endpoint:
        """A door to the network for `local`; returns what peers are told."""
        outside = Endpoint(local.flavour, self.host, port)
        self._exported[_folded(outside)] = local
        return outside

    def opened_inside(self, remote: Endpoint, port: int) -> Endpoint:
        """A loopback door to `remote`; returns what programs are told."""
        self._imported[port] = remote
        return Endpoint(remote.flavour, self._near, port)

    def closed_outside(self, local: Endpoint, port: int) -> None:
        """The door to the network at `port` for `local` is gone."""
        self._exported.pop(_folded(Endpoint(local.flavour, self.host, port)), None)
        self._spelt.pop(local, None)

    def closed_inside(self, port: int) -> None:
        """The loopback door at `port` is gone; the number may become a program's."""
        self._imported.pop(port, None)

    def spell(self, local: Endpoint, uri: str) -> None:
        """Remember how a program writes its own URI."""
        self._spelt[local] = uri

    def spelling(self, local: Endpoint) -> str:
        """The program's own URI, byte for byte."""
        return self._spelt.get(local, replace(local, host=self._near).uri)

    def program_behind(self, outside: Endpoint) -> Endpoint | None:
        """The program of this identity that a peer's address leads back to."""
        return self._exported.get(_folded(outside))

    def peer_behind(self, local: Endpoint) -> Endpoint | None:
        """The peer a loopback door leads to."""
        found = self._imported.get(local.port)
        return found if found is not None and found.flavour is local.flavour else None


def _folded(place: Endpoint) -> Endpoint:
    """Host names are the same in any case, and a URI that was parsed has lost its own."""
    return replace(place, host=place.host.lower())
