"""The sidecar of a host or of one program: a master on loopback, and an agent for each identity. A shell.

The identity of a call follows from the caller_id, never from data of a peer: with `identity` it is
always that one; otherwise each program uses the one enrolled for its name.
"""

import asyncio
import logging
import time
from functools import partial
from pathlib import Path
from typing import Final

from ca.certificates import Identity
from ca.errors import HintedError, NameRefused
from ca.names import check_name, shown
from grants.model import Right
from rossec import clock, environment
from rossec.channel.edhoc.credentials import KnownCertificates
from rossec.channel.edhoc.suites import OFFERED_SUITES
from rossec.channel.opening import WireProtocol
from rossec.errors import ConfigurationError, HangUp, PeerUnreachable
from rossec.home import NodeHome
from rossec.host.callers import Callers
from rossec.host.runner import TaskSet
from rossec.net.aio import SecureContext, SecureStream
from rossec.net.limits import HalfOpenCount, HalfOpenLimits
from rossec.net.rpc import serve_calls
from rossec.participant import connections, host_types, membership, registrations, slave_api
from rossec.participant.access import Access
from rossec.ros.names import MASTER, Settings, is_loopback
from rossec.ros.xmlrpc import Fault
from rossec.sidecar import egress, ingress, loopback_port
from rossec.sidecar.core import master_calls
from rossec.sidecar.core.layers import AgentState, EndpointMap, Layer, ListeningAddress
from rossec.sidecar.core.master_calls import MULTICALL, ResubscribeQueue, rule_of
from rossec.sidecar.executor import AgentServices, SlaveApiClient, run_layer

LIFETIME: Final = 5.0
_PERIOD: Final = 1.0
_log = logging.getLogger("rossec.sidecar")
_TAKEN: Final = "is roscore or another sidecar running? choose another port with --port"
LIMIT: Final = 256  # identities in use


class ConnectionCache:
    """Connections to peers' slave APIs, cached briefly for the program that looked them up."""

    # A port is opened only if the peer answers; the program that then connects to it reuses that one.

    def __init__(self) -> None:
        self._clients: dict[ListeningAddress, SlaveApiClient] = {}
        self._tasks = TaskSet()

    def put(self, remote: ListeningAddress, client: SlaveApiClient) -> None:
        old = self._clients.pop(remote, None)
        self._clients[remote] = client

        async def close_later() -> None:
            if old is not None:
                await old.rpc.close()
            await asyncio.sleep(LIFETIME)
            if self._clients.get(remote) is client:
                del self._clients[remote]
                await client.rpc.close()

        self._tasks.spawn(close_later(), "a cached connection")

    def take(self, remote: ListeningAddress) -> SlaveApiClient | None:
        return self._clients.pop(remote, None)

    async def close(self) -> None:
        await self._tasks.close()


class Resubscriber:
    """Publisher updates for the programs of one identity where no master sends one."""

    # Programs need not handle a topic whose connection ended and that they may subscribe to again, or
    # publishers that a restarted master did not list again.

    def __init__(self, services: AgentServices, agent: AgentState) -> None:
        self._services, self._agent = services, agent
        self._to_resubscribe = ResubscribeQueue()

    def on_topic_ended(self, topic: str, began: float) -> None:
        self._to_resubscribe.add(topic, began, time.monotonic())
        name = shown(topic)
        if not self._may_subscribe(topic):
            _log.warning("%s: no grant for subscribe on %s any more", self._services.name, name)

    async def run(self) -> None:
        while True:
            await asyncio.sleep(_PERIOD)
            await self._run_logged("expired publishers", master_calls.drop_expired_publishers(self._agent))
            for topic in self._to_resubscribe.take_due(time.monotonic(), self._may_subscribe):
                await self._run_logged(topic, master_calls.resubscribe(self._agent, topic))

    def _may_subscribe(self, topic: str) -> bool:
        return self._agent.access.holds(Right.SUBSCRIBE, topic, clock.now())

    async def _run_logged(self, subject: str, layer: Layer[None]) -> None:
        try:
            await run_layer(self._services, layer)
        except (HintedError, OSError, Fault) as error:
            what = shown(subject)
            _log.info("%s: cannot subscribe again: %s: %s", self._services.name, what, error)


class Agent:
    """Acts for the identity in `home`; if a task of it fails, all its connections are closed.

    Args:
        master_uri: of the loopback master.
        half_open: the unauthenticated connections at all ports of this process.
        master_name: the certified name of the secured master.
    """

    def __init__(
        self,
        home: NodeHome,
        settings: Settings,
        callers: Callers,
        master_uri: str,
        half_open: HalfOpenCount,
        suites: tuple[int, ...] = OFFERED_SUITES,
        master_name: str = MASTER,
    ) -> None:
        self.home, self.callers, self._settings = home, callers, settings
        loaded = membership.LoadedIdentity(home, home.name, master_name)
        access = Access(loaded.trust_status, master=master_name)
        endpoints = EndpointMap(settings.address or "", callers.loopback.host)
        publisher_grace = registrations.PublisherGrace(clock.counter())
        self.state = AgentState(
            loaded.identity, access, endpoints, master_uri, host_types.known_type, publisher_grace
        )
        context = SecureContext(
            loaded.live_credentials,
            loaded.anchors.verify,
            suites=suites,
            known=KnownCertificates(),
            accept_limits=ingress.ACCEPT_LIMITS,
            half_open=half_open,
            renews=Identity.renews,
        )
        self._connector = ingress.PeerConnector(context, access)
        self._connections: connections.ConnectionTable[SecureStream[Identity]] = connections.ConnectionTable(
            loaded.trust_status, master=master_name
        )
        self._membership = membership.Membership(loaded, access, self._connections, publisher_grace, self)
        self._resubscriber = Resubscriber(self, self.state)
        self._ingress = ingress.Ingress(
            self, self.state, self._connector, self._connections, home.filter_key, self._membership.take_push
        )
        self._egress = egress.Egress(
            self, self.state, self._connections, home.filter_key, self._resubscriber.on_topic_ended
        )
        self._cache = ConnectionCache()
        # What it offers as `AgentServices`, beside the methods below.
        self.open_ingress, self.suspend_ingress = self._ingress.open, self._ingress.suspend
        self.leads_to = self._ingress.leads_to
        self.open_egress, self.refuse_egress = self._egress.open, self._egress.refuse
        self.cache_client, self.cached_client = self._cache.put, self._cache.take
        self._refusals = egress.RefusalLog()
        self._has_failed = False
        self._start_lock = asyncio.Lock()
        self._started = False

    @property
    def name(self) -> str:
        return self.home.name

    async def handle_call(self, method: str, params: tuple[object, ...]) -> object:
        async with self._start_lock:  # the first call of a program connects with the master
            if self._has_failed:
                raise HangUp("a task of this identity has failed")
            if not self._started:
                await self._start()
        answer = await run_layer(self, master_calls.handle_call(self.state, method, params))
        if method not in registrations.GRAPH or not self._holds(Right.GRAPH, self.name):
            self._refusals.log_own(self.name, method, answer)
        return answer

    async def close(self) -> None:
        self._refusals.flush()
        await self._ingress.close()
        await self._egress.close()
        await self._cache.close()
        await self._membership.close()

    # --- agent services

    async def dial(self, remote: ListeningAddress) -> SecureStream[Identity]:
        own_identity = self.state.endpoints.program_at(remote) is not None
        return await self._connector.dial(remote, own_identity=own_identity)

    def note_unreachable(self, remote: ListeningAddress, error: PeerUnreachable) -> None:
        self._refusals.unreachable(remote.uri, error)

    def check_peer(self, peer: Identity) -> None:
        self.state.access.check_peer(peer, clock.now())

    async def call_master(self, method: str, params: tuple[object, ...]) -> object:
        # Refusals are logged, since a program may not print them.
        answer = await self._membership.session.forward(method, *params)
        self._refusals.log("the master", method, answer, params)
        return answer

    def proof(self, right: Right, name: str) -> bytes:
        return self.state.access.present(right, name, clock.now())

    # --- master and watchdog

    async def _start(self) -> None:
        try:
            stream = await self._membership.session.open()
        except (HintedError, OSError, TimeoutError) as error:
            _log.warning("%s: the master does not answer: %s", self.name, error)
            raise HangUp(str(error)) from error
        self.state.endpoints.host = self._settings.address or stream.local_address
        self._started = True
        self._membership.start()
        leaving = self._egress.followed.leave_regularly()
        self._membership.tasks.spawn(self._resubscriber.run(), f"{self.name}: resubscribe")
        self._membership.tasks.spawn(leaving, f"{self.name}: publishers to leave")

    # --- hooks of the membership (MembershipHooks)

    async def dial_master(self) -> SecureStream[Identity]:
        host, port = self._settings.master_host, self._settings.master_port
        return await self._connector.dial(ListeningAddress(WireProtocol.HTTP, host, port), allow_stale=True)

    async def dial_watch(self) -> SecureStream[Identity]:
        return await self.dial_master()

    async def restore(self) -> None:
        await run_layer(self, master_calls.restore(self.state, self._holds))

    async def rights_changed(self) -> None:
        # Make registrations again that were refused: roscpp and rospy never do so themselves.
        await run_layer(self, master_calls.rights_changed(self.state, self._holds))

    def _holds(self, right: Right, name: str) -> bool:
        return self.state.access.holds(right, name, clock.now())

    def maintain(self) -> None: ...

    def crashed(self, _: BaseException) -> None:
        self._has_failed = True
        self._connections.close("a task of this identity has failed")
        self._membership.tasks.spawn(self.close(), f"{self.name}: closing after a failure")


class Sidecar:
    """Serves the programs that `callers` allows.

    Args:
        identity: the name whose identity every program uses, if any.
        each: programs with their own identity use that instead.
        port: of the loopback master; 0 for any.
        master_name: the certified name of the secured master.
    """

    def __init__(
        self,
        home: Path,
        settings: Settings,
        callers: Callers,
        *,
        identity: str | None = None,
        each: bool = False,
        port: int = 0,
        suites: tuple[int, ...] = OFFERED_SUITES,
        master_name: str = MASTER,
    ) -> None:
        self._home, self._settings, self._callers = home, settings, callers
        self._each, self._suites, self._master_name = each, suites, master_name
        self._half_open = HalfOpenCount(HalfOpenLimits())
        self._agents: dict[str, Agent] = {}
        try:
            master = loopback_port.LoopbackPort(self._callers, self._serve, port)
        except OSError as error:
            address = self._callers.loopback.address
            raise ConfigurationError(
                f"cannot listen at {address} port {port}: {error.strerror}", _TAKEN
            ) from error
        if is_loopback(self._settings.master_host) and self._settings.master_port == master.port:
            raise ConfigurationError(
                f"ROS_MASTER_URI, {self._settings.master_uri}, is the sidecar's own address",
                "set it to where the secured master is, for the sidecar alone",
            )
        self._master = master
        self._default = None if identity is None else self._agent(NodeHome.of(home, identity))

    @property
    def uri(self) -> str:
        return ListeningAddress(WireProtocol.HTTP, self._callers.loopback.host, self._master.port).uri

    def start(self) -> None:
        self._master.open()

    async def close(self) -> None:
        await self._master.close()
        await asyncio.gather(*(agent.close() for agent in self._agents.values()))

    async def _serve(self, program: loopback_port.PlainStream) -> None:
        await serve_calls(program, partial(self._dispatch, program), compact=False)

    async def _dispatch(
        self, program: loopback_port.PlainStream, method: str, params: tuple[object, ...], _: str
    ) -> object:
        if method == MULTICALL and params == ([],):  # no caller: roslaunch without parameters
            return []
        refused = None if method == MULTICALL else slave_api.without_caller(params, rule_of(method).default)
        if refused is not None:
            return refused
        try:
            name = _caller(method, params)
            agent = await self._searching(program, name) if method == registrations.SEARCH else None
            agent = agent or self._agent_for(name)
            return await agent.handle_call(method, params)
        except (HangUp, Fault):
            raise
        except HintedError as error:
            _log.warning("%s: %s (%s)", method, error, error.hint)
            return [-1, f"rossec: {error} ({error.hint})", 0]
        except OSError as error:  # the files of the identity cannot be read
            _log.warning("%s: %s", method, error)
            return [-1, f"rossec: {error}", 0]

    async def _searching(self, program: loopback_port.PlainStream, space: str) -> Agent | None:
        # roscpp's `searchParam` calls with a namespace of its node. Several nodes in it, or one that has
        # this very name: the process decides.
        if self._default is not None and not self._each:
            return None
        prefix = space.rstrip("/") + "/"
        nodes = [
            (agent, api)
            for agent in self._agents.values()
            for api, node in agent.state.programs.items()
            if f"{node.name}/".startswith(prefix)
        ]
        agents = {agent for agent, _ in nodes}
        if len(agents) == 1 and not self._is_enrolled(space):
            return agents.pop()
        for agent, api in nodes:
            if await self._callers.is_program_at(program.socket, api.port):
                return agent
        return None

    def _is_enrolled(self, name: str) -> bool:
        try:
            return (NodeHome.find(self._home, check_name(name)).path / "node.key").exists()
        except NameRefused:
            return False

    def _agent_for(self, name: str) -> Agent:
        if self._default is not None and not self._each:
            return self._default
        try:
            # rosparam uses /rosparam-1234, an invalid ROS name; it means an anonymous one.
            home = NodeHome.find(self._home, check_name(name.replace("-", "_")))
        except NameRefused:
            if self._default is not None:
                return self._default
            raise
        if home.name in self._agents:
            return self._agents[home.name]
        if not (home.path / "node.key").exists():
            if self._default is not None:
                return self._default
            hint = f"{environment.missing_node(self._home, name)}; or use --as"
            raise ConfigurationError(f"{name} has no identity here", hint)
        if len(self._agents) >= LIMIT:
            raise ConfigurationError("too many identities in one sidecar")
        return self._agent(home)

    def _agent(self, home: NodeHome) -> Agent:
        agent = self._agents[home.name] = Agent(
            home, self._settings, self._callers, self.uri, self._half_open, self._suites, self._master_name
        )
        return agent


def _caller(method: str, params: tuple[object, ...]) -> str:
    if method != MULTICALL:
        return str(params[0])
    for element in params[0] if params and isinstance(params[0], list) else ():
        match element:
            case {"params": [str() as name, *_]}:
                return name
            case _:
                pass
    raise Fault(1, "missing required caller_id parameter")
