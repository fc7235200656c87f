"""One identity of the sidecar: assembles its parts and provides the agent services.

A shell around `layers.AgentState`. `participant.membership` holds the master session, `ingress` and
`egress` the ports; connections that expire or are revoked are cut. If a task fails, all are closed.
"""

import asyncio
import logging

from ca.certificates import Identity
from ca.errors import HintedError
from grants.model import Right
from rossec import clock
from rossec.channel.edhoc.known import KnownCertificates
from rossec.channel.edhoc.suites import PRODUCTION
from rossec.channel.opening import WireProtocol
from rossec.errors import HangUp, PeerUnreachable
from rossec.home import NodeHome
from rossec.net.aio import SecureContext, SecureStream
from rossec.net.halfopen import HalfOpenCount
from rossec.net.host.peeruid import Holder
from rossec.participant.access import Access
from rossec.participant.connections import ConnectionTable
from rossec.participant.host_types import known_type
from rossec.participant.membership import LoadedIdentity, Membership
from rossec.participant.publisher_grace import PublisherGrace
from rossec.participant.silent_answers import GRAPH
from rossec.ros.names import MASTER
from rossec.ros.settings import Settings
from rossec.sidecar.callers import Callers
from rossec.sidecar.connection_cache import ConnectionCache
from rossec.sidecar.connector import ACCEPT_LIMITS, PeerConnector
from rossec.sidecar.core import master_calls, registrations
from rossec.sidecar.core.endpoints import Endpoint, EndpointMap
from rossec.sidecar.core.layers import AgentState
from rossec.sidecar.egress import Egress
from rossec.sidecar.executor import SlaveApiClient, run_layer
from rossec.sidecar.ingress import Ingress
from rossec.sidecar.refusals import RefusalLog
from rossec.sidecar.resubscriber import Resubscriber

_log = logging.getLogger("rossec.sidecar")


class Agent:
    """Acts for the identity in `home`.

    Args:
        settings: where the master is and how peers reach this host.
        callers: the programs that may use it.
        master_uri: the URI of the loopback master.
        half_open: the unauthenticated connections at all ports of this process.
        suites: cipher suites, offered and accepted, in order of preference.
        master_name: the certified name of the secured master.
    """

    def __init__(
        self,
        home: NodeHome,
        settings: Settings,
        callers: Callers,
        master_uri: str,
        half_open: HalfOpenCount,
        suites: tuple[int, ...] = PRODUCTION,
        master_name: str = MASTER,
    ) -> None:
        self.home = home
        self.callers = callers
        self._settings = settings
        loaded = LoadedIdentity(home, home.name, master_name)
        access = Access(loaded.standing, master=master_name)
        endpoints = EndpointMap(settings.address or "", callers.loopback.host)
        publisher_grace = PublisherGrace(clock.counter())
        self.state = AgentState(
            loaded.identity, access, endpoints, master_uri, known_type, publisher_grace
        )
        context = SecureContext(
            loaded.live_credentials, loaded.anchors.verify, suites=suites,
            known=KnownCertificates(), accept_limits=ACCEPT_LIMITS, half_open=half_open,
            renews=Identity.renews,
        )  # fmt: skip
        self._connector = PeerConnector(context, access)
        self._connections: ConnectionTable[SecureStream[Identity]] = ConnectionTable(
            loaded.standing, master=master_name
        )
        self._membership = Membership(loaded, access, self._connections, publisher_grace, self)
        self._resubscriber = Resubscriber(self, self.state)
        self._ingress = Ingress(
            self, self.state, self._connector, self._connections, home.filter_key,
            self._membership.take_push,
        )  # fmt: skip
        self._egress = Egress(
            self, self.state, self._connections, home.filter_key, self._resubscriber.on_topic_ended
        )
        self._cache = ConnectionCache()
        self._refusals = RefusalLog()
        self._has_failed = False
        self._start_lock = asyncio.Lock()
        self._started = False

    @property
    def name(self) -> str:
        """The certified name."""
        return self.home.name

    async def handle_call(self, method: str, params: tuple[object, ...]) -> object:
        """Answer a program's call to its master."""
        await self._ensure_started()
        answer = await run_layer(self, master_calls.handle_call(self.state, method, params))
        if method not in GRAPH or not self._holds(Right.GRAPH, self.name):
            self._refusals.log_own(self.name, method, answer)
        return answer

    async def close(self) -> None:
        """Close every port and every connection."""
        self._refusals.flush()
        await self._ingress.close()
        await self._egress.close()
        await self._cache.close()
        await self._membership.close()

    # --- agent services

    def open_ingress(self, local: Endpoint) -> int:
        """The network port for `local`; it listens."""
        return self._ingress.open(local)

    def suspend_ingress(self, local: Endpoint) -> None:
        """Refuse callers for `local`: the program has ended."""
        self._ingress.suspend(local)

    def leads_to(self, local: Endpoint, listeners: list[Holder]) -> bool:
        """Whether `listeners` are the program that the port of `local` was opened for."""
        return self._ingress.leads_to(local, listeners)

    def open_egress(self, remote: Endpoint) -> int:
        """The loopback port for `remote`; it listens."""
        return self._egress.open(remote)

    def refuse_egress(self, remote: Endpoint) -> int:
        """The loopback port for `remote`; it refuses callers."""
        return self._egress.refuse(remote)

    def cache_client(self, remote: Endpoint, client: SlaveApiClient) -> None:
        """Cache a connection for the next caller of `remote`, for a few seconds."""
        self._cache.put(remote, client)

    def cached_client(self, remote: Endpoint) -> SlaveApiClient | None:
        """Take a cached connection to `remote`."""
        return self._cache.take(remote)

    async def dial(self, remote: Endpoint) -> SecureStream[Identity]:
        """Connect to a peer with a valid identity, or to a program of the same identity."""
        own_identity = self.state.endpoints.program_at(remote) is not None
        return await self._connector.dial(remote, own_identity=own_identity)

    def note_unreachable(self, remote: Endpoint, error: PeerUnreachable) -> None:
        """Say that no connection to a peer could be made; once an hour."""
        self._refusals.unreachable(remote.uri, error)

    def check_peer(self, peer: Identity) -> None:
        """Return if the identity of `peer` is still valid."""
        self.state.access.check_peer(peer, clock.now())

    async def call_master(self, method: str, params: tuple[object, ...]) -> object:
        """The master's answer; refusals are logged, since a program may not print them."""
        answer = await self._membership.session.forward(method, *params)
        self._refusals.log("the master", method, answer, params)
        return answer

    def proof(self, right: Right, name: str) -> bytes:
        """The grants for `right` on `name`."""
        return self.state.access.present(right, name, clock.now())

    # --- master and watchdog

    async def _ensure_started(self) -> None:
        """Connect to the master once; until it is up programs retry, as in ROS."""
        async with self._start_lock:
            if self._has_failed:
                raise HangUp("a task of this identity has failed")
            if self._started:
                return
            try:
                stream = await self._membership.session.open()
            except (HintedError, OSError, TimeoutError) as error:
                _log.warning("%s: the master does not answer: %s", self.name, error)
                raise HangUp(str(error)) from error
            self.state.endpoints.host = self._settings.address or stream.local_address
            self._started = True
            self._membership.start()
            self._membership.tasks.spawn(self._resubscriber.run(), f"{self.name}: resubscribe")
            self._membership.tasks.spawn(
                self._egress.leave_publishers(), f"{self.name}: publishers to leave"
            )

    # --- hooks of the membership (MembershipHooks)

    async def dial_master(self) -> SecureStream[Identity]:
        """Connect to the master; it provides fresh revocation data."""
        host, port = self._settings.master_host, self._settings.master_port
        return await self._connector.dial(Endpoint(WireProtocol.HTTP, host, port), allow_stale=True)

    async def dial_watch(self) -> SecureStream[Identity]:
        """Connect to the master once more, for a call that waits."""
        return await self.dial_master()

    async def restore(self) -> None:
        """Make every registration of the programs again."""
        await run_layer(self, registrations.restore(self.state, self._holds))

    async def rights_changed(self) -> None:
        """Make registrations again that were refused: roscpp and rospy never do so themselves."""
        await run_layer(self, registrations.rights_changed(self.state, self._holds))

    def _holds(self, right: Right, name: str) -> bool:
        return self.state.access.holds(right, name, clock.now())

    def maintain(self) -> None:
        """Nothing: `Resubscriber` drops expired publishers."""

    def crashed(self, _: BaseException) -> None:
        """Close what would not be checked any more."""
        self._has_failed = True
        self._connections.close("a task of this identity has failed")
        self._membership.tasks.spawn(self.close(), f"{self.name}: closing after a failure")
