"""What all layers share: commands, events, and the state of the identity they act for. Pure.

A layer is a generator: it yields a command, is sent the one event that fits it, and returns the outcome.
Any exception of a layer closes its connection; errors fail closed.
"""

from collections.abc import Generator, Mapping
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple, TypeAlias, TypeVar

from ca.certificates import Identity
from ca.errors import HintedError
from grants.model import Right
from rossec.channel.opening import WireProtocol
from rossec.errors import HangUp, RossecError
from rossec.participant.access import Access
from rossec.participant.definitions import FindDefinition
from rossec.participant.registrations import PublisherGrace, RegistrationTable
from rossec.ros.names import FORWARDED_PORT_PATH, is_forwarded_port, parse_uri

_SCHEMES: Final = {WireProtocol.HTTP: "http", WireProtocol.TCPROS: "rosrpc"}
Outcome = TypeVar("Outcome")
_LOOPBACK: Final = "127.0.0.1"


@dataclass(frozen=True)
class ListeningAddress:
    """A listening address, for XML-RPC (HTTP) or for topics and services (TCPROS)."""

    protocol: WireProtocol
    host: str
    port: int
    via_slave_api: bool = False  # `port` is the slave API's; the topic port is requested from it
    forwarded_port: bool = (
        False  # a slave API behind a relay, which leads TCPROS connections to the same node
    )

    @property
    def uri(self) -> str:
        """As in ROS: `http://host:port/` or `rosrpc://host:port`; a forwarded port's is `http://host:port/via`."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        end = "/" if self.protocol is WireProtocol.HTTP else ""
        end = FORWARDED_PORT_PATH if self.forwarded_port else end
        return f"{_SCHEMES[self.protocol]}://{host}:{self.port}{end}"


def local_endpoint(protocol: WireProtocol, port: int) -> ListeningAddress:
    return ListeningAddress(protocol, _LOOPBACK, port)


def topic_endpoint(api: ListeningAddress) -> ListeningAddress:
    return ListeningAddress(WireProtocol.TCPROS, api.host, api.port, via_slave_api=True)


def parse_endpoint(uri: object, protocol: WireProtocol) -> ListeningAddress | None:
    """The endpoint that a URI names; None: invalid, or of another protocol."""
    head = f"{_SCHEMES[protocol]}://"
    if not isinstance(uri, str) or not uri.startswith(head):
        return None
    try:
        address = parse_uri("http://" + uri.removeprefix(head))
    except HintedError:
        return None
    return ListeningAddress(
        protocol, *address, forwarded_port=protocol is WireProtocol.HTTP and is_forwarded_port(uri)
    )


class EndpointMap:
    """The endpoint mapping of one identity; peers reach this host at `host`.

    A program keeps its loopback port and gets a network port (ingress); a peer keeps its address and
    gets a loopback port (egress). An endpoint on this host is identified by its port, whatever host a
    program writes.
    """

    def __init__(self, host: str, loopback_host: str = _LOOPBACK) -> None:
        self.host, self._loopback_host = host, loopback_host
        self._ingress: dict[ListeningAddress, ListeningAddress] = {}  # network -> loopback
        self._egress: dict[int, ListeningAddress] = {}  # loopback port -> remote
        self._own_uris: dict[ListeningAddress, str] = {}
        self._apis: dict[ListeningAddress, ListeningAddress] = {}  # topics of a peer -> its slave API

    def add_ingress(self, local: ListeningAddress, port: int) -> ListeningAddress:
        """Map a network port to `local`; returns the endpoint for peers."""
        network = ListeningAddress(local.protocol, self.host, port)
        self._ingress[_casefolded(network)] = local
        return network

    def add_egress(self, remote: ListeningAddress, port: int) -> ListeningAddress:
        self._egress[port] = remote
        return ListeningAddress(remote.protocol, self._loopback_host, port)

    def remove_ingress(self, local: ListeningAddress, port: int) -> None:
        self._ingress.pop(_casefolded(ListeningAddress(local.protocol, self.host, port)), None)
        self._own_uris.pop(local, None)

    def remove_egress(self, port: int) -> None:
        """Forget the loopback port `port`; a program may bind it later."""
        remote = self._egress.pop(port, None)
        if remote is not None:
            self._apis.pop(remote, None)

    def set_api(self, topics: ListeningAddress, api: ListeningAddress) -> None:
        self._apis[topics] = api

    def api_of(self, topics: ListeningAddress) -> ListeningAddress | None:
        return self._apis.get(topics)

    def set_own_uri(self, local: ListeningAddress, uri: str) -> None:
        self._own_uris[local] = uri

    def own_uri(self, local: ListeningAddress) -> str:
        # Byte for byte as the program wrote it: roscpp compares it so to recognize itself.
        return self._own_uris.get(local, replace(local, host=self._loopback_host).uri)

    def network_of(self, local: ListeningAddress) -> ListeningAddress:
        """Where peers reach `local`; without a port for it, an address that nothing registered."""
        for network, program in self._ingress.items():
            if program == local:
                return network
        return replace(local, host=self.host)

    def program_at(self, network: ListeningAddress) -> ListeningAddress | None:
        return self._ingress.get(_casefolded(network))

    def peer_at(self, local: ListeningAddress) -> ListeningAddress | None:
        remote = self._egress.get(local.port)
        return remote if remote is not None and remote.protocol is local.protocol else None


def _casefolded(endpoint: ListeningAddress) -> ListeningAddress:
    # Names of hosts have no case (RFC 4343), and a peer may write the own one as it likes.
    return replace(endpoint, host=endpoint.host.lower())


class OpenIngress(NamedTuple):
    """Open a network port for a program's endpoint; always the same port. -> Opened"""

    local: ListeningAddress


class OpenEgress(NamedTuple):
    """Open a loopback port for a peer's endpoint; always the same port. -> Opened

    With `probe` it listens only if the peer answers; otherwise the port stays reserved and the
    kernel refuses callers, as for a dead node.
    """

    remote: ListeningAddress
    probe: bool = False


class Suspend(NamedTuple):
    """The program at this endpoint has ended: refuse callers, keep the port. -> CommandDone"""

    local: ListeningAddress


class CallMaster(NamedTuple):
    """Call the secured master. -> Answered, NoAnswer"""

    method: str
    params: tuple[object, ...]


class CallProgram(NamedTuple):
    """Call a program's slave API. -> Answered; NoAnswer"""

    local: ListeningAddress
    method: str
    params: tuple[object, ...]


class CallPeer(NamedTuple):
    """Call a peer's slave API, after presenting the grants for `right` on it.

    -> Answered; RawResponse if not `parse`; NoAnswer
    """

    remote: ListeningAddress
    method: str
    params: tuple[object, ...]
    right: Right | None = None
    parse: bool = True


class AuthenticatePeer(NamedTuple):
    """Connect to a peer, whose identity decides on the call or header that follows.

    The next `CallPeer` or `ConnectPeer` there uses this connection. -> PeerAuthenticated, NoAnswer
    """

    remote: ListeningAddress


class Probe(NamedTuple):
    """Check whether the program still listens. -> CommandDone, NoAnswer"""

    local: ListeningAddress


class ConnectProgram(NamedTuple):
    """Connect to a program for TCPROS and send this header. -> HeaderArrived, NoAnswer"""

    local: ListeningAddress
    fields: Mapping[str, bytes]


class ConnectPeer(NamedTuple):
    """Connect to a peer for TCPROS and send this header. -> HeaderArrived, NoAnswer"""

    remote: ListeningAddress
    fields: Mapping[str, bytes]


# Programs are reached only at loopback ports, peers only through the secure channel: no command sends
# plaintext to another host.
Request = CallMaster | CallProgram | CallPeer | AuthenticatePeer | Probe | ConnectProgram | ConnectPeer
Command = OpenIngress | OpenEgress | Suspend | Request


class PortOpened(NamedTuple):
    port: int  # on the network for `OpenIngress`, on loopback for `OpenEgress`


class Answered(NamedTuple):
    value: object  # of an XML-RPC call
    peer: Identity | None = None  # that answered


class PeerAuthenticated(NamedTuple):
    peer: Identity


class RawResponse(NamedTuple):
    body: bytes  # unparsed, to be forwarded unchanged


class HeaderArrived(NamedTuple):
    fields: Mapping[str, bytes]
    peer: Identity | None  # None: a program of this host
    now: int


class NoAnswer(NamedTuple):
    reason: str
    dead: bool = False  # nothing listens there any more, as opposed to slow or broken


@dataclass(frozen=True)
class CommandDone:
    """The command was executed; it has no result."""


Event = PortOpened | Answered | PeerAuthenticated | RawResponse | HeaderArrived | NoAnswer | CommandDone
Layer: TypeAlias = Generator[Command, Event, Outcome]


class UnexpectedEvent(RossecError):
    """The shell answered a command with an event of the wrong type: a bug."""


@dataclass
class Program:
    name: str
    registrations: RegistrationTable = field(default_factory=RegistrationTable)


@dataclass
class AgentState:
    """One identity the sidecar acts for."""

    identity: Identity
    access: Access
    endpoints: EndpointMap
    master_uri: str  # of the loopback master, as programs know it
    known_types: FindDefinition  # that this host knows
    publisher_grace: PublisherGrace  # of each topic that its programs subscribe to
    programs: dict[ListeningAddress, Program] = field(default_factory=dict)  # by their slave APIs

    def name_for(self, caller: str) -> str:
        """The caller_id for peers: the program's own if the identity covers it, else the identity."""
        # So it is always a certified name (attack L7).
        return caller if self.covers(caller) else self.identity.name

    def name_for_peer(self, caller: str, peer: Identity) -> str:
        return self.identity.name if peer.is_foreign else self.name_for(caller)

    def covers(self, name: str) -> bool:
        return self.identity.covers(name)

    def ingress_endpoint(self, local: ListeningAddress) -> Layer[ListeningAddress]:
        return self.endpoints.add_ingress(local, opened_port((yield OpenIngress(local))))

    def egress_uri(
        self, remote: ListeningAddress, own_api: ListeningAddress | None = None, *, probe: bool = False
    ) -> Layer[str]:
        """The URI at which a program reaches `remote`; its own URI is returned as it wrote it."""
        local = self.endpoints.program_at(remote)
        # Its own URI, as it wrote it; not a port at which the sidecar would call itself.
        if local is not None and local == own_api:
            return self.endpoints.own_uri(local)
        port = opened_port((yield OpenEgress(remote, probe=probe)))
        return self.endpoints.add_egress(remote, port).uri

    def followed_publishers(self, topic: object, uris: object) -> list[str]:
        valid = [uri for uri in uris if isinstance(uri, str)] if isinstance(uris, list) else []
        return self.publisher_grace.update(topic, valid) if isinstance(topic, str) else valid

    def is_listed(self, topic: str, publisher: ListeningAddress) -> bool:
        uris = self.publisher_grace.to_follow(topic)
        return any(parse_endpoint(uri, WireProtocol.HTTP) == publisher for uri in uris)

    def egress_uris(self, uris: object, own_api: ListeningAddress | None) -> Layer[list[str]]:
        """`egress_uri` for a list of slave API URIs; invalid ones are left out."""
        egress = []
        for uri in uris if isinstance(uris, list) else []:
            remote = parse_endpoint(uri, WireProtocol.HTTP)
            if remote is not None:
                egress.append((yield from self.egress_uri(remote, own_api)))
        return egress

    def forget(self, local: ListeningAddress) -> None:
        """The program at `local` has ended: do not register it with a restarted master."""
        self.programs.pop(local, None)


def opened_port(event: Event) -> int:
    if not isinstance(event, PortOpened):
        raise UnexpectedEvent(f"no port but {type(event).__name__}")
    return event.port


def authenticated_peer(event: Event) -> Identity:
    match event:
        case PeerAuthenticated(peer):
            return peer
        case NoAnswer(reason=reason):
            raise HangUp(reason)
        case _:
            raise UnexpectedEvent(f"no peer but {type(event).__name__}")


def own_endpoint(uri: object) -> ListeningAddress | None:
    api = parse_endpoint(uri, WireProtocol.HTTP)
    return None if api is None else local_endpoint(WireProtocol.HTTP, api.port)
