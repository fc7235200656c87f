"""Several masters in one process, of one domain or of two, that follow each other."""

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator, Sequence
from typing import Any

from ca.certificates import Identity
from ca.domains import DomainList, ForeignDomain, sign_domains
from ca.keys.signing import to_coordinates
from rossec.federation.mesh import Mesh, mesh_of
from rossec.federation.settings import FederationConfig, SiteSettings
from rossec.master.api.methods import DomainsChanged, RevocationsChanged
from rossec.master.server.server import MasterServer, master_of
from rossec.net.aio import SecureContext, WireProtocol, connect
from rossec.net.rpc.calls import RpcClient
from rossec.node import Node
from rossec.ros.names import PRESENT_GRANTS, parse_uri
from tests.support.site import DAY, Site

TYPE = "std_msgs/String"


class Master:
    """One master of `site`, in this process."""

    def __init__(self, site: Site, name: str = "/master") -> None:
        self.site, self.name = site, name
        self.home = site.enroll(name)
        self.server: MasterServer
        self.mesh: Mesh
        self._following: asyncio.Task[Any] | None = None
        self._port = 0
        self.domains = b""

    async def start(self) -> None:
        self.server = master_of(
            self.home,
            host="127.0.0.1",
            port=self._port,
            now=self.site.now(),
            newest=self.site.authority.store.newest_list(),
        )
        await self.server.start()
        self._port = self.server.port
        if self.domains:
            self.server.state.trust.update_domains(self.domains)

    async def stop(self) -> None:
        """End at once: neither side says goodbye."""
        if self._following is not None:
            self._following.cancel()
            await asyncio.gather(self._following, return_exceptions=True)
            self._following = None
        await self.server.close()

    def follow(self, *sites: SiteSettings) -> Mesh:
        self.mesh = mesh_of(self.server, self.home, FederationConfig(sites=sites))
        self._following = asyncio.ensure_future(self.mesh.run())
        return self.mesh

    def as_site(self, label: str, domain: str = "", *patterns: str) -> SiteSettings:
        return SiteSettings(label, self.server.uri, self.name, domain, patterns)

    async def register(self, node: str, topic: str, port: int = 4711) -> None:
        """Have `node` publish `topic`; its slave API is on a port where nobody listens."""
        grant = self.site.publish(node, topic)
        async with self.caller(node) as client:
            await client.ask(PRESENT_GRANTS, node, [grant])
            uri = f"http://127.0.0.1:{port}/"
            await client.ask("registerPublisher", node, topic, TYPE, uri)

    def unregister(self, node: str) -> None:
        for event in self.server.state.registry.remove_node(node):
            self.server.effects.deliver(event)
        self.server.state.notify()

    def node(self, name: str) -> Node:
        """A node that works with this master."""
        self.site.enroll(name)
        environ = {
            "ROSSEC_HOME": str(self.site.root),
            "ROS_IP": "127.0.0.1",
            "ROS_MASTER_URI": self.server.uri,
            "ROSSEC_MASTER": self.name,
        }
        return Node(name, environ=environ)

    @property
    def list_number(self) -> tuple[int, int]:
        return self.server.state.trust.list_number

    def take_list(self, data: bytes) -> None:
        """As `rossec ca publish` to this master."""
        if self.server.state.trust.update(data, self.site.now()):
            self.server.effects.deliver(RevocationsChanged("/ca"))

    def take_tree(self, data: bytes, entries: bytes) -> None:
        """The same with a tree."""
        if self.server.state.trust.update_tree(data, entries, self.site.now()):
            self.server.effects.deliver(RevocationsChanged("/ca"))

    def take_domains(self, data: bytes) -> None:
        """As a list of domains delivered to this master."""
        if self.server.state.trust.update_domains(data):
            self.server.effects.deliver(DomainsChanged("/ca"))

    def want(self, *topics: str) -> None:
        """As if local nodes looked these up; none: as if a tool listed the graph."""
        state = self.server.state
        for topic in topics:
            state.imports.demand.ask(topic, state.now())
        if not topics:
            state.imports.demand.ask_everything(state.now())
        state.notify()

    def imported(self, topic: str) -> list[str]:
        return self.server.state.imports.publisher_uris(topic)

    def state_of(self, label: str) -> dict[str, Any]:
        rows = self.mesh.status()["sites"]
        return next((row for row in rows if row["label"] == label), {"state": "", "error": ""})

    @contextlib.asynccontextmanager
    async def caller(self, node: str) -> AsyncIterator[RpcClient]:
        """A connection of an enrolled node."""
        home = self.site.enroll(node)
        context: SecureContext[Identity] = SecureContext(home.credentials(), home.anchor().verify)
        host, port = parse_uri(self.server.uri)
        stream = await connect(host, port, context, WireProtocol.HTTP)
        try:
            yield RpcClient(stream)
        finally:
            await stream.close()


def domain_list(site: Site, *masters: str, foreign: Sequence[ForeignDomain] = (), seq: int = 1) -> bytes:
    """A list of domains of `site`, with these masters."""
    now = int(time.time())
    keys = tuple(sorted(to_coordinates(site.identity(name).public_key) for name in masters))
    listed = DomainList(1, seq, now, now + DAY, tuple(sorted(foreign, key=lambda each: each.domain)), keys)
    return sign_domains(site.authority.authority.signer, listed, site.anchor.domain)


@contextlib.asynccontextmanager
async def masters(site: Site, *names: str) -> AsyncIterator[list[Master]]:
    """The masters of one domain, all in its list."""
    started: list[Master] = []
    try:
        for name in names:
            site.enroll(name)
        data = domain_list(site, *names)
        for name in names:
            master = Master(site, name)
            master.domains = data
            await master.start()
            started.append(master)
        yield started
    finally:
        for master in started:
            await master.stop()
