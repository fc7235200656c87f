"""Endpoints and the two mapping tables for rewriting addresses. Pure.

A program keeps its loopback port and gets a network port (ingress); a peer keeps its address and
gets a loopback port (egress). A program's own URI is returned to it byte for byte: roscpp compares
it so to recognize itself. An endpoint on this host is identified by its port, whatever host a
program writes; programs get the host name by which they reach loopback.
"""

from dataclasses import dataclass, replace
from typing import Final, NamedTuple

from ca.errors import HintedError
from rossec.channel.opening import WireProtocol
from rossec.ros.settings import DOOR_PATH, is_door, parse_uri


class Loopback(NamedTuple):
    """The loopback address of programs and sidecar, and its host name in URIs."""

    address: str
    host: str


LOOPBACK: Final = Loopback("127.0.0.1", "127.0.0.1")
_SCHEMES: Final = {WireProtocol.HTTP: "http", WireProtocol.TCPROS: "rosrpc"}


@dataclass(frozen=True)
class Endpoint:
    """A listening address, for XML-RPC (HTTP) or for topics and services (TCPROS).

    Attributes:
        via_slave_api: `port` is the slave API's; the topic port is requested from it.
        door: a slave API behind a relay, which leads TCPROS connections to the same node.
    """

    protocol: WireProtocol
    host: str
    port: int
    via_slave_api: bool = False
    door: bool = False

    @property
    def uri(self) -> str:
        """As in ROS: `http://host:port/` or `rosrpc://host:port`; a door's is `http://host:port/via`."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        end = "/" if self.protocol is WireProtocol.HTTP else ""
        end = DOOR_PATH if self.door else end
        return f"{_SCHEMES[self.protocol]}://{host}:{self.port}{end}"


def local_endpoint(protocol: WireProtocol, port: int) -> Endpoint:
    """The endpoint of a program on this host."""
    return Endpoint(protocol, LOOPBACK.host, port)


def topic_endpoint(api: Endpoint) -> Endpoint:
    """The topic endpoint of a program; its slave API is asked for the port on each connection."""
    return Endpoint(WireProtocol.TCPROS, api.host, api.port, via_slave_api=True)


def parse_endpoint(uri: object, protocol: WireProtocol) -> Endpoint | None:
    """The endpoint that a URI names; None: invalid, or of another protocol."""
    head = f"{_SCHEMES[protocol]}://"
    if not isinstance(uri, str) or not uri.startswith(head):
        return None
    try:
        address = parse_uri("http://" + uri.removeprefix(head))
    except HintedError:
        return None
    return Endpoint(protocol, *address, door=protocol is WireProtocol.HTTP and is_door(uri))


class EndpointMap:
    """The endpoint mapping of one identity.

    Args:
        host: where peers reach this host.
        loopback_host: where programs reach it.
    """

    def __init__(self, host: str, loopback_host: str = LOOPBACK.host) -> None:
        self.host = host
        self._loopback_host = loopback_host
        self._ingress: dict[Endpoint, Endpoint] = {}  # network -> loopback
        self._egress: dict[int, Endpoint] = {}  # loopback port -> remote
        self._own_uris: dict[Endpoint, str] = {}
        self._apis: dict[Endpoint, Endpoint] = {}  # topics of a peer -> its slave API

    def add_ingress(self, local: Endpoint, port: int) -> Endpoint:
        """Map a network port to `local`; returns the endpoint for peers."""
        network = Endpoint(local.protocol, self.host, port)
        self._ingress[_casefolded(network)] = local
        return network

    def add_egress(self, remote: Endpoint, port: int) -> Endpoint:
        """Map a loopback port to `remote`; returns the endpoint for programs."""
        self._egress[port] = remote
        return Endpoint(remote.protocol, self._loopback_host, port)

    def remove_ingress(self, local: Endpoint, port: int) -> None:
        """Forget the network port `port` for `local`."""
        self._ingress.pop(_casefolded(Endpoint(local.protocol, self.host, port)), None)
        self._own_uris.pop(local, None)

    def remove_egress(self, port: int) -> None:
        """Forget the loopback port `port`; a program may bind it later."""
        remote = self._egress.pop(port, None)
        if remote is not None:
            self._apis.pop(remote, None)

    def set_api(self, topics: Endpoint, api: Endpoint) -> None:
        """The peer at `api` said that its topics are there."""
        self._apis[topics] = api

    def api_of(self, topics: Endpoint) -> Endpoint | None:
        """The slave API of the peer whose topics are there; None: not known."""
        return self._apis.get(topics)

    def set_own_uri(self, local: Endpoint, uri: str) -> None:
        """Store a program's own URI as the program writes it."""
        self._own_uris[local] = uri

    def own_uri(self, local: Endpoint) -> str:
        """The program's own URI, byte for byte."""
        return self._own_uris.get(local, replace(local, host=self._loopback_host).uri)

    def network_of(self, local: Endpoint) -> Endpoint:
        """Where peers reach `local`; without a port for it, an address that nothing registered."""
        for network, program in self._ingress.items():
            if program == local:
                return network
        return replace(local, host=self.host)

    def program_at(self, network: Endpoint) -> Endpoint | None:
        """The program of this identity at a network endpoint."""
        return self._ingress.get(_casefolded(network))

    def peer_at(self, local: Endpoint) -> Endpoint | None:
        """The peer at a loopback endpoint."""
        remote = self._egress.get(local.port)
        return remote if remote is not None and remote.protocol is local.protocol else None


def _casefolded(endpoint: Endpoint) -> Endpoint:
    """Host names are case-insensitive, and a parsed URI is in lower case."""
    return replace(endpoint, host=endpoint.host.lower())
