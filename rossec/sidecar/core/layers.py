"""What all layers share: the identity they act for, its doors and registrations. Pure.

A layer is a generator: it yields a command, is sent the event, and returns the outcome. Whatever a
layer raises closes the connection it was for; nothing passes because of a mistake.
"""

from collections.abc import Generator
from dataclasses import dataclass, field
from typing import TypeAlias, TypeVar

from ca.certificates import Identity
from rossec.channel.opening import WireProtocol
from rossec.errors import RossecError
from rossec.participant.access import Access
from rossec.participant.definitions import FindDefinition
from rossec.participant.publisher_grace import PublisherGrace
from rossec.sidecar.core.commands import Command, OpenEgress, OpenIngress
from rossec.sidecar.core.endpoints import Endpoint, EndpointMap, local_endpoint, parse_endpoint
from rossec.sidecar.core.events import Event, Opened

Outcome = TypeVar("Outcome")
Layer: TypeAlias = Generator[Command, Event, Outcome]


class UnexpectedEvent(RossecError):
    """The shell answered a command with an event that does not fit: a mistake of ours."""


@dataclass
class Program:
    """A program's slave API: the name it registered under, and what it has registered."""

    name: str
    registrations: dict[tuple[str, str], tuple[object, ...]] = field(default_factory=dict)


@dataclass
class AgentState:
    """One identity the sidecar acts for.

    Attributes:
        identity: who it is.
        access: what it can prove, and what it lets others do.
        endpoints: which address stands for which.
        master_uri: the loopback master, as programs know it.
        known_types: what this host knows of a message type.
        publisher_grace: the publishers of each topic that its programs follow.
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
        """The name peers hear: the program's own if the identity covers it, else the certified one.

        So the answer to "who asks" is always a certified name (attack L7).
        """
        return caller if self.covers(caller) else self.identity.name

    def covers(self, name: str) -> bool:
        """Whether a program may go by `name`."""
        return self.identity.covers(name)

    def ingress_endpoint(self, local: Endpoint) -> Layer[Endpoint]:
        """The address under which peers reach the program at `local`."""
        return self.endpoints.add_ingress(local, opened_port((yield OpenIngress(local))))

    def egress_uri(
        self, remote: Endpoint, own: Endpoint | None = None, *, probe: bool = False
    ) -> Layer[str]:
        """The URI under which a program reaches `remote`; its own it gets back as it wrote it."""
        local = self.endpoints.program_at(remote)
        if local is not None and local == own:
            return self.endpoints.own_uri(local)
        port = opened_port((yield OpenEgress(remote, probe=probe)))
        return self.endpoints.add_egress(remote, port).uri

    def followed_publishers(self, topic: object, uris: object) -> list[str]:
        """The publishers to follow of those the master names, and of those it may yet name."""
        named = [uri for uri in uris if isinstance(uri, str)] if isinstance(uris, list) else []
        return self.publisher_grace.update(topic, named) if isinstance(topic, str) else named

    def egress_uris(self, uris: object, own: Endpoint | None) -> Layer[list[str]]:
        """`bring` for a list of slave API URIs; what is no URI is left out."""
        found = []
        for uri in uris if isinstance(uris, list) else []:
            remote = parse_endpoint(uri, WireProtocol.HTTP)
            if remote is not None:
                found.append((yield from self.egress_uri(remote, own)))
        return found

    def forget(self, local: Endpoint) -> None:
        """The program at `local` is gone: a restarted master need not hear of it."""
        self.programs.pop(local, None)


def opened_port(event: Event) -> int:
    """The port of a door."""
    if not isinstance(event, Opened):
        raise UnexpectedEvent(f"no door but {type(event).__name__}")
    return event.port


def own_endpoint(uri: object) -> Endpoint | None:
    """The slave API of the calling program: on this host, whatever host name it writes."""
    found = parse_endpoint(uri, WireProtocol.HTTP)
    return None if found is None else local_endpoint(WireProtocol.HTTP, found.port)
