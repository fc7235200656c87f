"""State shared by all layers: the identity they act for, its endpoints and registrations. Pure.

A layer is a generator: it yields a command, is sent the event, and returns the outcome. Any
exception of a layer closes its connection; errors fail closed.
"""

from collections.abc import Generator
from dataclasses import dataclass, field
from typing import TypeAlias, TypeVar

from ca.certificates import Identity
from rossec.channel.opening import WireProtocol
from rossec.errors import HangUp, RossecError
from rossec.participant.access import Access
from rossec.participant.definitions import FindDefinition
from rossec.participant.publisher_grace import PublisherGrace
from rossec.participant.registrations import RegistrationTable
from rossec.sidecar.core.commands import Command, OpenEgress, OpenIngress
from rossec.sidecar.core.endpoints import Endpoint, EndpointMap, local_endpoint, parse_endpoint
from rossec.sidecar.core.events import Event, NoAnswer, Opened, PeerAuthenticated

Outcome = TypeVar("Outcome")
Layer: TypeAlias = Generator[Command, Event, Outcome]


class UnexpectedEvent(RossecError):
    """The shell answered a command with an event of the wrong type: a bug."""


@dataclass
class Program:
    """A program's slave API: the name it registered under, and its registrations."""

    name: str
    registrations: RegistrationTable = field(default_factory=RegistrationTable)


@dataclass
class AgentState:
    """One identity the sidecar acts for.

    Attributes:
        identity: its certificate data.
        access: its own grants, and the authorization of peers.
        endpoints: the mapping of network and loopback endpoints.
        master_uri: the loopback master, as programs know it.
        known_types: finds a message type that this host knows.
        publisher_grace: the publishers of each topic that its programs subscribe to.
        programs: the slave APIs of its programs.
    """

    identity: Identity
    access: Access
    endpoints: EndpointMap
    master_uri: str
    known_types: FindDefinition
    publisher_grace: PublisherGrace
    programs: dict[Endpoint, Program] = field(default_factory=dict)

    def name_for(self, caller: str) -> str:
        """The caller_id for peers: the program's own if the identity covers it, else the identity.

        So it is always a certified name (attack L7).
        """
        return caller if self.covers(caller) else self.identity.name

    def name_for_peer(self, caller: str, peer: Identity) -> str:
        """As `name_for`; a foreign peer honours no certified tails."""
        return self.identity.name if peer.is_foreign else self.name_for(caller)

    def covers(self, name: str) -> bool:
        """Whether a program may use `name`."""
        return self.identity.covers(name)

    def ingress_endpoint(self, local: Endpoint) -> Layer[Endpoint]:
        """The endpoint at which peers reach the program at `local`."""
        return self.endpoints.add_ingress(local, opened_port((yield OpenIngress(local))))

    def egress_uri(
        self, remote: Endpoint, own_api: Endpoint | None = None, *, probe: bool = False
    ) -> Layer[str]:
        """The URI at which a program reaches `remote`; its own URI is returned as it wrote it."""
        local = self.endpoints.program_at(remote)
        if local is not None and local == own_api:
            return self.endpoints.own_uri(local)
        port = opened_port((yield OpenEgress(remote, probe=probe)))
        return self.endpoints.add_egress(remote, port).uri

    def followed_publishers(self, topic: object, uris: object) -> list[str]:
        """The publishers to connect to: those the master names, and those in their grace period."""
        valid = [uri for uri in uris if isinstance(uri, str)] if isinstance(uris, list) else []
        return self.publisher_grace.update(topic, valid) if isinstance(topic, str) else valid

    def is_listed(self, topic: str, publisher: Endpoint) -> bool:
        """Whether the master lists the node with this slave API, or may list it again."""
        uris = self.publisher_grace.to_follow(topic)
        return any(parse_endpoint(uri, WireProtocol.HTTP) == publisher for uri in uris)

    def egress_uris(self, uris: object, own_api: Endpoint | None) -> Layer[list[str]]:
        """`egress_uri` for a list of slave API URIs; invalid ones are left out."""
        egress = []
        for uri in uris if isinstance(uris, list) else []:
            remote = parse_endpoint(uri, WireProtocol.HTTP)
            if remote is not None:
                egress.append((yield from self.egress_uri(remote, own_api)))
        return egress

    def forget(self, local: Endpoint) -> None:
        """The program at `local` has ended: do not register it with a restarted master."""
        self.programs.pop(local, None)


def opened_port(event: Event) -> int:
    """The port of an `Opened` event."""
    if not isinstance(event, Opened):
        raise UnexpectedEvent(f"no port but {type(event).__name__}")
    return event.port


def authenticated_peer(event: Event) -> Identity:
    """The peer of a `PeerAuthenticated` event.

    Raises:
        HangUp: there is no answer.
    """
    match event:
        case PeerAuthenticated(peer):
            return peer
        case NoAnswer(reason=reason):
            raise HangUp(reason)
        case _:
            raise UnexpectedEvent(f"no peer but {type(event).__name__}")


def own_endpoint(uri: object) -> Endpoint | None:
    """The slave API endpoint of the calling program: on this host, whatever host it writes."""
    api = parse_endpoint(uri, WireProtocol.HTTP)
    return None if api is None else local_endpoint(WireProtocol.HTTP, api.port)
