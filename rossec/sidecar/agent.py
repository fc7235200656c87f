"""One identity of the sidecar, in its parts; the house that visits are made for.

A shell around `layers.AgentState`. `membership` is its standing with the master, `exports` and
`imports` are its doors, and the watch cuts what expires or is revoked: without it nothing goes on.
"""

import asyncio

from ca.certificates import Identity
from grants.model import Right
from rossec import clock
from rossec.channel.edhoc.credentials import LiveCredentials
from rossec.channel.edhoc.suites import PRODUCTION
from rossec.channel.opening import WireProtocol
from rossec.errors import HangUp
from rossec.home import NodeHome
from rossec.net.aio import SecureStream
from rossec.net.aio.tasks import TaskSet
from rossec.net.halfopen import HalfOpenCount
from rossec.participant.access import Access
from rossec.participant.connections import AcceptedConnections
from rossec.participant.publisher_grace import PublisherGrace
from rossec.participant.revocation_watch import ConnectionWatchdog
from rossec.ros.settings import Settings
from rossec.saved_revocations import saved_revocations
from rossec.sidecar.callers import Callers
from rossec.sidecar.connection_cache import ConnectionCache
from rossec.sidecar.connector import PeerConnector
from rossec.sidecar.core import master_calls
from rossec.sidecar.core.endpoints import Endpoint, EndpointMap
from rossec.sidecar.core.layers import AgentState
from rossec.sidecar.egress import Egress
from rossec.sidecar.executor import CommandExecutor, SlaveApiClient
from rossec.sidecar.host_types import known_type
from rossec.sidecar.ingress import Ingress
from rossec.sidecar.membership import Membership
from rossec.sidecar.peer_connections import PeerConnections


class Agent:
    """Acts for the identity in `home`.

    Args:
        outside: where the master is and how peers reach this host.
        callers: which programs may use it.
        master_uri: the loopback master, as its programs know it.
        half_open: what strangers have begun at any door of this process.
        suites: offered and accepted, in order of preference.
    """

    def __init__(
        self,
        home: NodeHome,
        outside: Settings,
        callers: Callers,
        master_uri: str,
        half_open: HalfOpenCount,
        suites: tuple[int, ...] = PRODUCTION,
    ) -> None:
        self.home = home
        self.callers = callers
        self._outside = outside
        anchor, credentials = home.anchor(), LiveCredentials(home.credentials())
        revocations = saved_revocations(home, anchor, clock.now())
        access = Access(anchor, revocations)
        identity = home.identity(clock.now())
        doors = EndpointMap(outside.address or "", callers.loopback.host)
        named = PublisherGrace(clock.counter())
        self.tenant = AgentState(identity, access, doors, master_uri, known_type, named)
        self._network = PeerConnector(credentials, anchor, access, suites, half_open)
        self._links, guests = PeerConnections(revocations), AcceptedConnections()
        self._watch = ConnectionWatchdog(revocations, lambda: self._links, guests)
        self._membership = Membership(
            self, home, self.tenant, credentials, revocations,
            self._dial_master, self._watch.cut,
        )  # fmt: skip
        self._exports = Ingress(
            self, self.tenant, self._network, self._links, guests, home.filter_key,
            self._membership.revocations_arrived,
        )  # fmt: skip
        self._imports = Egress(
            self, self.tenant, self._links, home.filter_key, self._membership.topic_ended
        )
        self._kept = ConnectionCache()
        self._watching = TaskSet(self._blind)
        self._is_blind = False
        self._opening = asyncio.Lock()
        self._started = False

    @property
    def name(self) -> str:
        """The certified name."""
        return self.home.name

    async def call_master(self, method: str, params: tuple[object, ...]) -> object:
        """Answer a program's call to its master."""
        await self._start()
        visit = CommandExecutor(self)
        try:
            return await visit.run(master_calls.call(self.tenant, method, params))
        finally:
            await visit.close()

    async def close(self) -> None:
        """Close every door, end every connection."""
        await self._exports.close()
        await self._imports.close()
        await self._watching.close()
        await self._kept.close()
        await self._membership.close()

    # --- what a visit needs

    def export(self, local: Endpoint) -> int:
        """The port outside for `local`."""
        return self._exports.open(local)

    def rest(self, local: Endpoint) -> None:
        """Refuse callers for `local`: the program is gone."""
        self._exports.rest(local)

    def bring(self, remote: Endpoint) -> int:
        """The loopback port for `remote`; it listens."""
        return self._imports.open(remote)

    def shut(self, remote: Endpoint) -> int:
        """The loopback port for `remote`; it refuses callers."""
        return self._imports.rest(remote)

    def keep(self, remote: Endpoint, correspondent: SlaveApiClient) -> None:
        """Keep a connection for the next caller of `remote`, for a moment."""
        self._kept.keep(remote, correspondent)

    def kept(self, remote: Endpoint) -> SlaveApiClient | None:
        """Such a connection, for this caller alone."""
        return self._kept.take(remote)

    async def dial(self, remote: Endpoint) -> SecureStream[Identity]:
        """Connect to a peer whose identity holds, or to a program of the same identity."""
        own = self.tenant.doors.program_behind(remote) is not None
        return await self._network.dial(remote, own=own)

    def check(self, peer: Identity) -> None:
        """Return if the identity of `peer` holds still."""
        self.tenant.access.check_peer(peer, clock.now())

    async def ask_master(self, method: str, params: tuple[object, ...]) -> object:
        """The master's answer."""
        return await self._membership.answer(method, params)

    def proof(self, right: Right, name: str) -> bytes:
        """Grants that prove `right` on `name`."""
        return self.tenant.access.present(right, name, clock.now())

    # --- the master, and the watch

    async def _start(self) -> None:
        """Meet the master; a program that calls before it is there tries again, as in ROS."""
        async with self._opening:
            if self._is_blind:
                raise HangUp("nobody watches over the connections of this identity any more")
            if self._started:
                return
            met_from = await self._membership.begin()
            self.tenant.doors.host = self._outside.address or met_from
            self._started = True
            self._watching.spawn(self._watch.run(), f"{self.name}: watch")

    async def _dial_master(self) -> SecureStream[Identity]:
        host, port = self._outside.master_host, self._outside.master_port
        return await self._network.dial(Endpoint(WireProtocol.HTTP, host, port), news=True)

    def _blind(self, _: BaseException) -> None:
        """The watch has died: what it would no longer cut must not go on."""
        self._is_blind = True
        self._links.abort("nobody watches over it any more")
        self._watching.spawn(self.close(), f"{self.name}: closing after a failure")
