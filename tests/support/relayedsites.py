"""Relays of several sites in one process, with masters of theirs and no routers between."""

import asyncio
import contextlib
import hashlib
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

from ca.certificates import Identity
from ca.domains import Anchors, ForeignDomain
from rossec.errors import LinkEnded
from rossec.master.state.forwarded_ports import ForwardedPort, Target
from rossec.net.aio import SecureContext, SecureServer, SecureStream, WireProtocol, connect, serve
from rossec.overlay.documents import Peer
from rossec.overlay.forwarded_ports import OpenPorts
from rossec.overlay.homes import RelayFiles
from rossec.overlay.link_frames import inbox
from rossec.overlay.masters import RelayMember
from rossec.overlay.relay import Relay
from tests.support.masters import Master, domain_list
from tests.support.site import DAY, Site
from tests.support.witness import until

Serve = Callable[[SecureStream[Identity]], Awaitable[None]]


@dataclass
class Wires:
    """Inboxes: each that is read is a port of loopback."""

    ports: dict[str, int] = field(default_factory=dict)


class WireNetwork:
    """What a relay needs of routers, over TCP."""

    def __init__(self, wires: Wires, account: str, context: SecureContext[Identity]) -> None:
        self._wires, self.account, self._context = wires, account, context
        self.router = "tcp/127.0.0.1:7447"
        self.dialled: list[str] = []

    async def dial(self, inbox: str) -> SecureStream[Identity]:
        self.dialled.append(inbox)
        if inbox not in self._wires.ports:
            raise LinkEnded("nobody answers")
        port = self._wires.ports[inbox]
        return await connect("127.0.0.1", port, self._context, WireProtocol.HTTP)

    def listen(self, inbox: str, serve_one: Serve, _label: str) -> SecureServer[Identity]:
        server = serve(serve_one, "127.0.0.1", 0, self._context, WireProtocol.HTTP)
        self._wires.ports[inbox] = server.port
        return server


class RelayedSite:
    """A domain with a master and a relay, both in this process."""

    def __init__(self, root: Path, domain: str, wires: Wires) -> None:
        self.site = Site(root, domain)
        self.domain, self.wires = domain, wires
        self.label = domain.partition(".")[0]
        for name in ("/master", "/relay"):
            self.site.enroll(name)
        self.master = Master(self.site)
        self.files = RelayFiles(self.site.enroll("/relay"))
        self.listed = 0
        self.relay: Relay
        self.member: RelayMember
        self.network: WireNetwork
        self.running: asyncio.Task[None] | None = None

    def trust(
        self,
        *others: "RelayedSite",
        admitted: tuple[str, ...] = ("/**",),
        exported: tuple[tuple[str, int], ...] | None = None,
    ) -> bytes:
        """The newest list of domains: these, and no others."""
        self.listed += 1
        until_then = int(time.time()) + DAY
        entries = [
            ForeignDomain(
                each.domain, each.label, each.site.anchor.certificate, admitted, 3600, until_then, exported
            )
            for each in others
        ]
        self.master.domains = domain_list(self.site, "/master", foreign=entries, seq=self.listed)
        return self.master.domains

    def box(self, other: "RelayedSite") -> str:
        """Of the inbox that is told to `other`."""
        return hashlib.sha256(f"{self.domain} {other.domain}".encode()).hexdigest()[:32]

    def relay_inbox(self, other: "RelayedSite") -> str:
        """Where `other` sends to."""
        return inbox(self.label, bytes.fromhex(self.box(other)))

    def add(self, other: "RelayedSite") -> None:
        """Descriptors were exchanged with `other`."""
        key = other.relay_inbox(self)
        peer = Peer(other.label, self.box(other), other.label, "/relay", key)
        self.files.change(lambda peers: peers.update({other.label: peer}))

    def remove(self, other: "RelayedSite") -> None:
        self.files.change(lambda peers: peers.__delitem__(other.label))

    async def start(self) -> None:
        """Start the relay; the master runs."""
        environ = {
            "ROSSEC_HOME": str(self.site.root),
            "ROS_MASTER_URI": self.master.server.uri,
            "ROS_IP": "127.0.0.1",
        }
        self.member = RelayMember("/relay", environ)
        self.network = WireNetwork(self.wires, self.label, self.member.link_context)
        self.relay = Relay(self.member, cast("Any", self.network), OpenPorts("127.0.0.1"), self.files.peers)
        self.running = asyncio.ensure_future(self.relay.run())

    async def stop(self) -> None:
        """End the relay."""
        if self.running is not None:
            self.running.cancel()
            await asyncio.gather(self.running, return_exceptions=True)

    async def forwarded_port(self, peer: str, kind: str, name: str) -> ForwardedPort:
        """The forwarded port that the master gets for a target."""
        forwarded_ports, target = self.master.server.state.forwarded_ports, Target(peer, kind, name)
        forwarded_ports.want(f"{peer} {kind} {name}", [target])
        await until(lambda: forwarded_ports.forwarded_port(target) is not None)
        found = forwarded_ports.forwarded_port(target)
        assert found is not None
        return found

    async def through(
        self,
        forwarded_port: ForwardedPort,
        caller: str = "/master",
        protocol: WireProtocol = WireProtocol.HTTP,
    ) -> SecureStream[Identity]:
        """A connection of a node of this site through a forwarded port."""
        home = self.site.enroll(caller)
        anchors = Anchors(self.site.anchor)
        anchors.update(self.master.domains)
        context = SecureContext(home.credentials(), anchors.verify)
        return await connect(forwarded_port.host, forwarded_port.port, context, protocol)


@contextlib.asynccontextmanager
async def two_sites(root: Path, *, told: bool = True) -> AsyncIterator[tuple[RelayedSite, RelayedSite]]:
    """A home and an office that trust each other, whose relays have each other's descriptors.

    `told`: the masters have heard of each other's revocations.
    """
    wires = Wires()
    home, office = (RelayedSite(root / each, f"{each}.example", wires) for each in ("home", "office"))
    both = home, office
    try:
        for one, other in (both, both[::-1]):
            one.trust(other)
            one.add(other)
            await one.master.start()
        for one, other in (both, both[::-1]) if told else ():
            tell(one, other)
        for each in both:
            await each.start()
        await until(lambda: all(each.member.is_connected for each in both))
        yield both
    finally:
        for each in both:
            await each.stop()
        for each in both:
            with contextlib.suppress(AttributeError):
                await each.master.stop()


def tell(here: RelayedSite, there: RelayedSite) -> None:
    """The master here has the newest word of the one there on its revocations."""
    revocations, timestamp = there.master.server.state.trust.current(there.site.now())
    chain = there.site.enroll("/master").credentials().chain
    here.master.server.effects.take_foreign(there.domain, revocations, timestamp, list(chain))
