"""Network ports for programs: peers call a slave API, subscribe to topics, call services. A shell.

Each connection runs one layer after another; an error closes that connection on both sides. A network port
leads to the socket that listened when it was opened, not to whoever has the number of its port later.
"""

import asyncio
import contextlib
import logging
from collections.abc import Callable
from typing import Final

from ca.certificates import Identity
from ca.errors import HintedError, RevocationsStale
from ca.names import shown
from rossec import clock
from rossec.channel.opening import WireProtocol
from rossec.channel.records import ChannelLimits
from rossec.errors import ChannelClosed, HangUp, RossecError
from rossec.host.local_ports import PortPool, bind_free_port
from rossec.host.local_sockets import Holder
from rossec.host.runner import TaskSet
from rossec.net.aio import SecureContext, SecureStream, connect
from rossec.net.aio.server import Handler, SecureServer, serve
from rossec.net.limits import ACCEPTED, PREAUTH_LIMIT
from rossec.participant import authorized, definitions, delivery_options
from rossec.participant.access import Access
from rossec.participant.connections import ConnectionTable, serve_peer
from rossec.ros import names, tcpros, xmlrpc
from rossec.sidecar import loopback_port, pump
from rossec.sidecar.core import guards, node_connections
from rossec.sidecar.core.layers import AgentState, ListeningAddress
from rossec.sidecar.executor import AgentServices, CommandExecutor

# Peers send headers and requests; what programs send leaves in small units.
ACCEPT_LIMITS: Final = {
    **ACCEPTED,
    WireProtocol.TCPROS: ChannelLimits(
        unit=tcpros.MESSAGE_LIMIT + xmlrpc.BODY_LIMIT, preauth_limit=PREAUTH_LIMIT
    ),
}
HEADER_DEADLINE: Final = 15.0  # includes the handshake with the program
_ENDED: Final = 64  # ports of ended programs that are kept bound: `rosnode cleanup` tries them
_log = logging.getLogger("rossec.sidecar")
PushHandler = Callable[[str, tuple[object, ...], Identity], None]


class PeerConnector:
    """Connects one identity to peers, each checked before anything is sent to it, and listens for them."""

    def __init__(self, context: SecureContext[Identity], access: Access) -> None:
        self._context, self._access = context, access

    async def dial(
        self, remote: ListeningAddress, *, allow_stale: bool = False, own_identity: bool = False
    ) -> SecureStream[Identity]:
        stream = await connect(
            remote.host, remote.port, self._context, remote.protocol, to_itself=own_identity
        )
        try:
            self._access.check_peer(stream.peer, clock.now())
        except HintedError as error:
            if not (allow_stale and isinstance(error, RevocationsStale)):
                stream.abort("the peer's identity is invalid")
                raise HangUp(str(error), error.hint) from error
        return stream

    def listen(self, handler: Handler[Identity], host: str, protocol: WireProtocol) -> SecureServer[Identity]:
        # The port is bound explicitly, so that the kernel reserves it while the server is suspended.
        bind = host if names.is_loopback(host) else None
        return bind_free_port(lambda port: serve(handler, bind, port, self._context, protocol))


class Ingress:
    """The network ports of one identity; `on_push` takes a signed update from the master."""

    def __init__(
        self,
        services: AgentServices,
        agent: AgentState,
        connector: PeerConnector,
        connections: ConnectionTable[SecureStream[Identity]],
        filter_key: definitions.FilterKey,
        on_push: PushHandler,
    ) -> None:
        self._services, self._agent, self._connector = services, agent, connector
        self._connections, self._filter_key, self._on_push = connections, filter_key, on_push
        self._tasks = TaskSet()
        self._copies = guards.CopyTracker()
        self._memories = guards.ProgramMemories(authorized.memory_scope(agent.identity.name), self._is_dead)
        self.ports = PortPool(self._close_port, self._is_dead)
        self._listeners: dict[ListeningAddress, list[Holder]] = {}  # of each port, when it was opened
        self._ended: PortPool[int, SecureServer[Identity]] = PortPool(self._close_ended, limit=_ENDED)

    def open(self, local: ListeningAddress) -> int:
        listeners = self._services.callers.listeners(local.port)
        if not self.leads_to(local, listeners):
            # The program has ended, and another one has its port. Peers keep the address of the network port:
            # it stays bound, and refuses, or the master would have the new program shut down for the old one.
            for each in [each for each in self._listeners if each.port == local.port]:
                self._retire(each)
        server = self.ports.get_or_open(local, lambda: self._listen(local))
        if listeners:
            self._listeners[local] = listeners
        server.resume()
        return server.port

    def leads_to(self, local: ListeningAddress, listeners: list[Holder]) -> bool:
        # Also if there is no such port, or nothing listened when it was opened.
        return not listeners or self._listeners.get(local, listeners) == listeners

    def _retire(self, local: ListeningAddress) -> None:
        del self._listeners[local]
        server = self.ports.remove(local)
        if server is not None:
            server.suspend()
            self._agent.endpoints.remove_ingress(local, server.port)
            self._ended.get_or_open(server.port, lambda: server)

    def suspend(self, local: ListeningAddress) -> None:
        server = self.ports.get(local)
        if server is not None:
            server.suspend()

    async def close(self) -> None:
        for server in (*self.ports, *self._ended):
            await server.close()
        await self._tasks.close()

    def _listen(self, local: ListeningAddress) -> SecureServer[Identity]:
        serve = self._serve_tcpros if local.protocol is WireProtocol.TCPROS else self._serve_slave_api

        async def handler(stream: SecureStream[Identity]) -> None:
            with contextlib.suppress(TimeoutError):
                await serve(local, stream)

        host = self._agent.endpoints.host
        return self._connector.listen(self._connections.bounded(handler), host, local.protocol)

    def _close_port(self, local: ListeningAddress, server: SecureServer[Identity]) -> None:
        self._agent.endpoints.remove_ingress(local, server.port)
        self._agent.forget(local)
        self._listeners.pop(local, None)
        self._close_ended(server.port, server)

    def _close_ended(self, port: int, server: SecureServer[Identity]) -> None:
        self._tasks.spawn(server.close(), f"network port {port}")

    def _is_dead(self, local: ListeningAddress) -> bool:
        listeners = self._services.callers.listeners(local.port)
        return not listeners or not self.leads_to(local, listeners)

    # --- XML-RPC

    async def _serve_slave_api(self, local: ListeningAddress, stream: SecureStream[Identity]) -> None:
        presented: list[bytes] = []
        executor = CommandExecutor(self._services)

        async def dispatch(method: str, params: tuple[object, ...], peer: Identity) -> object:
            try:
                match method, params:
                    case update, (_, *rest) if update in names.SIGNED_UPDATES:
                        if not self._agent.access.is_master(peer):
                            raise RossecError(f"{update} is for the master alone")
                        self._on_push(update, (*rest,), peer)
                        return [1, "", 0]
                    case names.PRESENT_GRANTS, (_, bytes() as grants):
                        presented[:] = [grants]
                    case _:
                        pass
                now = clock.now()
                proof = presented[0] if presented else None
                agent = self._agent
                layer = node_connections.handle_peer_call(agent, local, peer, method, params, proof, now)
                return await executor.run(layer)
            except HangUp:
                raise
            except HintedError as error:
                # The peer is told why its own grants do not suffice, and no hint, which is for people here.
                _log.warning("refused %s: %s (%s)", shown(peer.name), error, error.hint)
                return [-1, f"rossec: {error}", 0]

        try:
            await serve_peer(stream, dispatch, self._agent.access)
        finally:
            await executor.close()

    # --- TCPROS

    async def _serve_tcpros(self, local: ListeningAddress, stream: SecureStream[Identity]) -> None:
        executor = CommandExecutor(self._services)
        try:
            try:
                async with asyncio.timeout(HEADER_DEADLINE):
                    fields, after_request = await pump.split_header(stream)
                    layer = node_connections.admit_peer(
                        self._agent,
                        local,
                        fields,
                        stream.peer,
                        self._filter_key,
                        lambda name: self._memories.acquire(name, local),
                        clock.now(),
                    )
                    admitted = await executor.run(layer)
            except HangUp:
                raise
            except HintedError as error:
                _log.warning("refused %s: %s (%s)", shown(stream.peer.name), error, error.hint)
                await stream.send(tcpros.error_header(f"rossec: {error}"))
                return
            if executor.program is not None:
                await self._forward(admitted, executor.program, stream, after_request, executor.after_header)
        except (HangUp, ChannelClosed) as error:
            _log.info("%s: %s", shown(stream.peer.name), error)
        finally:
            await executor.close()

    async def _forward(
        self,
        admitted: node_connections.AdmittedConnection,
        program: loopback_port.PlainStream,
        stream: SecureStream[Identity],
        after_request: bytes,
        after_answer: bytes,
    ) -> None:
        latching, peer = admitted.answer.get("latching") == b"1", shown(stream.peer.name)
        shared = self._copies.share(admitted.guard, clock.time(), latching=latching)
        with pump.log_end(peer), shared as (guard, initial):
            replacing = guards.Replacing(guard, admitted.rebuild, to_peer=True)
            connection = authorized.AuthorizedConnection(
                stream, admitted.decision, admitted.guard, replacing.rebuild, replacing.swap
            )
            with self._connections.track(connection):
                await stream.send(tcpros.encode(admitted.answer))
                if admitted.service:
                    stream.raise_unit_limit()
                    await pump.exchange(program, stream, after_answer, after_request)
                elif after_request:
                    _log.warning("%s sends data where it subscribes", peer)
                elif admitted.options:
                    sender = delivery_options.DeliveryQueue(stream, admitted.options)
                    if initial:
                        sender.enqueue(initial)
                    await pump.publish_by_options(program, stream, guard, after_answer, sender)
                else:
                    if initial:
                        await stream.send(*pump.framed(initial))
                    await pump.publish(program, stream, guard, after_answer)
