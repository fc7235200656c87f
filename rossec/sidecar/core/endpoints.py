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

    protocol: WireProtocol
    host: str
    port: int
    via_slave_api: bool = False

    @property
    def uri(self) -> str:
        """As in ROS: `http://host:port/` or `rosrpc://host:port`."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        end = "/" if self.protocol is WireProtocol.HTTP else ""
        return f"{_SCHEMES[self.protocol]}://{host}:{self.port}{end}"


def local_endpoint(protocol: WireProtocol, port: int) -> Endpoint:
    """The endpoint of a program of this host."""
    return Endpoint(protocol, LOOPBACK.host, port)


def topic_endpoint(api: Endpoint) -> Endpoint:
    """Where the topics of the program with this slave API are: it is asked when somebody comes."""
    return Endpoint(WireProtocol.TCPROS, api.host, api.port, via_slave_api=True)


def parse_endpoint(uri: object, protocol: WireProtocol) -> Endpoint | None:
    """The endpoint a URI names; None: it is not one of this kind."""
    head = f"{_SCHEMES[protocol]}://"
    if not isinstance(uri, str) or not uri.startswith(head):
        return None
    try:
        return Endpoint(protocol, *parse_uri("http://" + uri.removeprefix(head)))
    except HintedError:
        return None


class EndpointMap:
    """The doors of one identity.

    Args:
        host: where peers reach this host.
        near: where programs reach it.
    """

    def __init__(self, host: str, loopback_host: str = LOOPBACK.host) -> None:
        self.host = host
        self._loopback_host = loopback_host
        self._ingress: dict[Endpoint, Endpoint] = {}  # outside -> inside
        self._egress: dict[int, Endpoint] = {}  # loopback port -> remote
        self._own_uris: dict[Endpoint, str] = {}

    def add_ingress(self, local: Endpoint, port: int) -> Endpoint:
        """A door to the network for `local`; returns what peers are told."""
        outside = Endpoint(local.protocol, self.host, port)
        self._ingress[_casefolded(outside)] = local
        return outside

    def add_egress(self, remote: Endpoint, port: int) -> Endpoint:
        """A loopback door to `remote`; returns what programs are told."""
        self._egress[port] = remote
        return Endpoint(remote.protocol, self._loopback_host, port)

    def remove_ingress(self, local: Endpoint, port: int) -> None:
        """The door to the network at `port` for `local` is gone."""
        self._ingress.pop(_casefolded(Endpoint(local.protocol, self.host, port)), None)
        self._own_uris.pop(local, None)

    def remove_egress(self, port: int) -> None:
        """The loopback door at `port` is gone; the number may become a program's."""
        self._egress.pop(port, None)

    def set_own_uri(self, local: Endpoint, uri: str) -> None:
        """Remember how a program writes its own URI."""
        self._own_uris[local] = uri

    def own_uri(self, local: Endpoint) -> str:
        """The program's own URI, byte for byte."""
        return self._own_uris.get(local, replace(local, host=self._loopback_host).uri)

    def program_at(self, outside: Endpoint) -> Endpoint | None:
        """The program of this identity that a peer's address leads back to."""
        return self._ingress.get(_casefolded(outside))

    def peer_at(self, local: Endpoint) -> Endpoint | None:
        """The peer a loopback door leads to."""
        found = self._egress.get(local.port)
        return found if found is not None and found.protocol is local.protocol else None


def _casefolded(endpoint: Endpoint) -> Endpoint:
    """Host names are the same in any case, and a URI that was parsed has lost its own."""
    return replace(endpoint, host=endpoint.host.lower())
