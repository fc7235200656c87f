"""Network ports for programs: peers call a slave API, subscribe to topics, call services.

A shell. Each connection runs one layer after another; an error closes that connection on both
sides. A refused peer is told why its own grants do not suffice, and no more. A network port leads
to the socket that listened when it was opened, not to whoever has the number of its port later:
the master would have another program shut down in the place of one that has ended.
"""

import asyncio
import contextlib
import logging
from collections.abc import Callable
from typing import Final

from ca.certificates import Identity
from ca.domains.aliases import shown
from ca.errors import HintedError
from rossec import clock
from rossec.channel.opening import WireProtocol
from rossec.errors import CallRefused, ChannelClosed, HangUp
from rossec.net.aio import SecureStream
from rossec.net.aio.server import SecureServer
from rossec.net.aio.tasks import TaskSet
from rossec.net.host.peeruid import Holder
from rossec.participant.authorized import AuthorizedConnection
from rossec.participant.connections import ConnectionTable
from rossec.participant.limit_memory import memory_scope
from rossec.participant.slave_serving import serve_peer
from rossec.participant.topic_guard import FilterKey
from rossec.ros import header, names
from rossec.ros.names import SIGNED_UPDATES
from rossec.sidecar import pump, wish_pump
from rossec.sidecar.connector import PeerConnector
from rossec.sidecar.core import slave_calls, tcpros
from rossec.sidecar.core.copies import CopyTracker
from rossec.sidecar.core.endpoints import Endpoint
from rossec.sidecar.core.layers import AgentState
from rossec.sidecar.core.program_memory import ProgramMemories
from rossec.sidecar.core.replacing import Replacing
from rossec.sidecar.core.tcpros import AdmittedConnection
from rossec.sidecar.executor import AgentServices, CommandExecutor
from rossec.sidecar.plain_stream import PlainStream
from rossec.sidecar.port_pool import PortPool
from rossec.sidecar.pump import split_header
from rossec.sidecar.wish_pump import WishSender

HEADER_DEADLINE: Final = 15.0  # includes the handshake with the program
_ENDED: Final = 64  # ports of ended programs that are kept bound: `rosnode cleanup` tries them

_log = logging.getLogger("rossec.sidecar")
PushHandler = Callable[[str, tuple[object, ...], Identity], None]


class Ingress:
    """The network ports of one identity.

    Args:
        services: the services of its agent.
        filter_key: finds a key for pseudonyms by its name.
        on_push: takes a signed update from the master.
    """

    def __init__(
        self,
        services: AgentServices,
        agent: AgentState,
        connector: PeerConnector,
        connections: ConnectionTable[SecureStream[Identity]],
        filter_key: FilterKey,
        on_push: PushHandler,
    ) -> None:
        self._services = services
        self._agent = agent
        self._connector = connector
        self._connections = connections
        self._filter_key = filter_key
        self._on_push = on_push
        self._tasks = TaskSet()
        self._copies = CopyTracker()
        self._memories = ProgramMemories(memory_scope(agent.identity.name), self._is_dead)
        self.ports = PortPool(self._close_port, self._is_dead)
        self._listeners: dict[Endpoint, list[Holder]] = {}  # of each port, when it was opened
        self._ended: PortPool[int, SecureServer[Identity]] = PortPool(
            self._close_ended, limit=_ENDED
        )

    def open(self, local: Endpoint) -> int:
        """The network port for the program that listens at `local` now; it listens."""
        listeners = self._services.callers.listeners(local.port)
        if not self.leads_to(local, listeners):
            for each in [each for each in self._listeners if each.port == local.port]:
                self._retire(each)
        server = self.ports.get_or_open(local, lambda: self._listen(local))
        if listeners:
            self._listeners[local] = listeners
        server.resume()
        return server.port

    def leads_to(self, local: Endpoint, listeners: list[Holder]) -> bool:
        """Whether `listeners` are those for which the port of `local` was opened.

        Also if there is no such port, or nothing listened when it was opened.
        """
        return not listeners or self._listeners.get(local, listeners) == listeners

    def _retire(self, local: Endpoint) -> None:
        """Its program has ended and another one has the port: refuse callers for good."""
        del self._listeners[local]
        server = self.ports.remove(local)
        if server is not None:
            server.suspend()
            self._agent.endpoints.remove_ingress(local, server.port)
            self._ended.get_or_open(server.port, lambda: server)

    def suspend(self, local: Endpoint) -> None:
        """Refuse callers for `local`: the program has ended."""
        server = self.ports.get(local)
        if server is not None:
            server.suspend()

    async def close(self) -> None:
        """Close every port."""
        for server in (*self.ports, *self._ended):
            await server.close()
        await self._tasks.close()

    def _listen(self, local: Endpoint) -> SecureServer[Identity]:
        serve = (
            self._serve_tcpros if local.protocol is WireProtocol.TCPROS else self._serve_slave_api
        )

        async def handler(stream: SecureStream[Identity]) -> None:
            with contextlib.suppress(TimeoutError):
                await serve(local, stream)

        host = self._agent.endpoints.host
        return self._connector.listen(self._connections.bounded(handler), host, local.protocol)

    def _close_port(self, local: Endpoint, server: SecureServer[Identity]) -> None:
        self._agent.endpoints.remove_ingress(local, server.port)
        self._agent.forget(local)
        self._listeners.pop(local, None)
        self._close_ended(server.port, server)

    def _close_ended(self, port: int, server: SecureServer[Identity]) -> None:
        self._tasks.spawn(server.close(), f"network port {port}")

    def _is_dead(self, local: Endpoint) -> bool:
        listeners = self._services.callers.listeners(local.port)
        return not listeners or not self.leads_to(local, listeners)

    # --- XML-RPC

    async def _serve_slave_api(self, local: Endpoint, stream: SecureStream[Identity]) -> None:
        """A peer's calls to a program's slave API."""
        presented: list[bytes] = []
        executor = CommandExecutor(self._services)

        async def dispatch(method: str, params: tuple[object, ...], peer: Identity) -> object:
            try:
                match method, params:
                    case update, (_, *rest) if update in SIGNED_UPDATES:
                        return self._take_push(peer, update, (*rest,))
                    case names.PRESENT_GRANTS, (_, bytes() as grants):
                        presented[:] = [grants]
                    case _:
                        pass
                now = clock.now()
                proof = presented[0] if presented else None
                agent = self._agent
                layer = slave_calls.handle_peer_call(agent, local, peer, method, params, proof, now)
                return await executor.run(layer)
            except HangUp:
                raise
            except HintedError as error:
                _log.warning("refused %s: %s (%s)", shown(peer.name), error, error.hint)
                return [-1, f"rossec: {error}", 0]

        try:
            await serve_peer(stream, dispatch, self._agent.access)
        finally:
            await executor.close()

    def _take_push(self, peer: Identity, method: str, params: tuple[object, ...]) -> object:
        if not self._agent.access.is_master(peer):
            raise CallRefused(f"{method} is for the master alone")
        self._on_push(method, params, peer)
        return [1, "", 0]

    # --- TCPROS

    async def _serve_tcpros(self, local: Endpoint, stream: SecureStream[Identity]) -> None:
        """A peer that subscribes to a program's topic, or calls its service."""
        executor = CommandExecutor(self._services)
        try:
            try:
                async with asyncio.timeout(HEADER_DEADLINE):
                    fields, after_request = await split_header(stream)
                    layer = tcpros.admit_peer(
                        self._agent, local, fields, stream.peer, self._filter_key,
                        lambda name: self._memories.acquire(name, local), clock.now(),
                    )  # fmt: skip
                    admitted = await executor.run(layer)
            except HangUp:
                raise
            except HintedError as error:
                _log.warning("refused %s: %s (%s)", shown(stream.peer.name), error, error.hint)
                await stream.send(header.error_header(f"rossec: {error}"))
                return
            if executor.program is not None:
                await self._forward(
                    admitted, executor.program, stream, after_request, executor.after_header
                )
        except (HangUp, ChannelClosed) as error:
            _log.info("%s: %s", shown(stream.peer.name), error)
        finally:
            await executor.close()

    async def _forward(
        self,
        admitted: AdmittedConnection,
        program: PlainStream,
        stream: SecureStream[Identity],
        after_request: bytes,
        after_answer: bytes,
    ) -> None:
        decision, now, latching = admitted.decision, clock.time(), admitted.latching
        with (
            pump.log_end(shown(stream.peer.name)),
            self._copies.share(admitted.guard, now, latching=latching) as (guard, initial),
        ):
            replacing = Replacing(guard, admitted.rebuild, to_peer=True)
            connection = AuthorizedConnection(
                stream, decision, admitted.guard, replacing.rebuild, replacing.swap
            )
            with self._connections.track(connection):
                await stream.send(header.encode(admitted.answer))
                if admitted.service:
                    stream.raise_unit_limit()
                    await pump.exchange(program, stream, after_answer, after_request)
                elif after_request:
                    _log.warning("%s sends data where it subscribes", shown(stream.peer.name))
                elif admitted.wishes:
                    sender = WishSender(stream, admitted.wishes)
                    sender.put(initial)
                    await wish_pump.publish(program, stream, guard, after_answer, sender)
                else:
                    if initial:
                        await stream.send(*pump.framed(initial))
                    await pump.publish(program, stream, guard, after_answer)
