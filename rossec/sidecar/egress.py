"""Loopback ports for peers: programs call a peer's slave API, subscribe to topics, call services.

A shell. Each connection runs one layer after another; an error closes that connection on both
sides.
"""

import asyncio
import logging
import time
from collections.abc import Callable, Mapping
from typing import Final

from ca.certificates import Identity
from ca.domains.aliases import shown
from ca.errors import HintedError
from rossec import clock
from rossec.channel.opening import WireProtocol
from rossec.errors import HangUp, RossecError
from rossec.net.aio import SecureStream
from rossec.net.aio.tasks import TaskSet
from rossec.net.bounds import message_limit, unit_limit
from rossec.net.rpc.client import serve_calls
from rossec.participant.authorized import AuthorizedConnection
from rossec.participant.connections import ConnectionTable
from rossec.participant.followed_publishers import PERIOD, FollowedPublishers
from rossec.participant.header_fields import text
from rossec.participant.limit_memory import memory_scope
from rossec.participant.topic_guard import FilterKey
from rossec.ros import header
from rossec.ros.header import MESSAGE_LIMIT
from rossec.sidecar import pump
from rossec.sidecar.core import slave_calls, tcpros
from rossec.sidecar.core.copies import ReplaceableGuard
from rossec.sidecar.core.endpoints import Endpoint
from rossec.sidecar.core.layers import AgentState
from rossec.sidecar.core.program_memory import ProgramMemories
from rossec.sidecar.core.replacing import Replacing
from rossec.sidecar.core.tcpros import AdmittedConnection
from rossec.sidecar.executor import AgentServices, CommandExecutor
from rossec.sidecar.loopback_port import LoopbackPort
from rossec.sidecar.plain_stream import PlainStream
from rossec.sidecar.port_pool import PortPool
from rossec.sidecar.pump import split_header
from rossec.sidecar.refusals import RefusalLog

HEADER_DEADLINE: Final = 15.0  # includes the handshake with the peer

_log = logging.getLogger("rossec.sidecar")


class Egress:
    """The loopback ports of one identity.

    Args:
        services: the services of its agent.
        filter_key: finds a key for pseudonyms by its name.
        on_topic_ended: called with the topic and the start (monotonic) of a connection that ended.
    """

    def __init__(
        self,
        services: AgentServices,
        agent: AgentState,
        connections: ConnectionTable[SecureStream[Identity]],
        filter_key: FilterKey,
        on_topic_ended: Callable[[str, float], None],
    ) -> None:
        self._services = services
        self._agent = agent
        self._connections = connections
        self._filter_key = filter_key
        self._on_topic_ended = on_topic_ended
        self._tasks = TaskSet()
        self._refusals = RefusalLog()
        self._memories: ProgramMemories[CommandExecutor] = ProgramMemories(
            memory_scope(agent.identity.name)
        )
        self._followed: FollowedPublishers[Endpoint] = FollowedPublishers(agent.is_listed)
        self.ports = PortPool(self._close_port)

    def open(self, remote: Endpoint) -> int:
        """The loopback port for `remote`; it listens."""
        listener = self._port_for(remote)
        listener.open()
        return listener.port

    def refuse(self, remote: Endpoint) -> int:
        """The loopback port for `remote`; the kernel refuses callers."""
        listener = self._port_for(remote)
        listener.suspend()
        return listener.port

    async def close(self) -> None:
        """Close every port."""
        self._refusals.flush()
        for listener in self.ports:
            await listener.close()
        await self._tasks.close()

    def _port_for(self, remote: Endpoint) -> LoopbackPort:
        serve = (
            self._serve_tcpros if remote.protocol is WireProtocol.TCPROS else self._serve_slave_api
        )

        async def handler(program: PlainStream) -> None:
            await serve(remote, program)

        callers = self._services.callers
        return self.ports.get_or_open(remote, lambda: LoopbackPort(callers, handler))

    def _close_port(self, _: Endpoint, listener: LoopbackPort) -> None:
        self._agent.endpoints.remove_egress(listener.port)
        self._tasks.spawn(listener.close(), f"loopback port {listener.port}")

    async def _serve_slave_api(self, remote: Endpoint, program: PlainStream) -> None:
        """A program's calls to a peer's slave API."""
        executor = CommandExecutor(self._services)

        async def dispatch(method: str, params: tuple[object, ...], _: str) -> object:
            layer = slave_calls.handle_program_call(self._agent, remote, method, params)
            answer = await executor.run(layer)
            self._refusals.log(remote.uri, method, answer)
            return answer

        try:
            await serve_calls(program, dispatch, compact=False)
        finally:
            await executor.close()

    async def _serve_tcpros(self, remote: Endpoint, program: PlainStream) -> None:
        """A program that subscribes to a peer's topic, or calls its service."""
        executor = CommandExecutor(self._services)
        fields: Mapping[str, bytes] = {}
        began = time.monotonic()
        try:
            try:
                async with asyncio.timeout(HEADER_DEADLINE):
                    fields, after_request = await split_header(program)
                    layer = tcpros.connect_to_peer(
                        self._agent, remote, fields, self._filter_key,
                        lambda name: self._memories.acquire(name, executor), clock.now(),
                    )  # fmt: skip
                    admitted = await executor.run(layer)
            except HangUp as error:
                _log.info("no connection to %s: %s", remote.uri, error)
                self._topic_ended(fields, began)  # rospy would give it up
                return
            except HintedError as error:
                _log.warning("no connection to %s: %s (%s)", remote.uri, error, error.hint)
                await program.send(header.error_header(f"rossec: {error}"))
                await program.close()
                return
            if executor.stream is not None:
                began = time.monotonic()
                self._follow(executor.stream, remote, fields)
                await self._forward(
                    admitted, program, executor.stream, after_request, executor.after_header
                )
                self._topic_ended(fields, began)
        except (RossecError, TimeoutError) as error:
            _log.info("a connection to %s ended: %s", remote.uri, error)
        finally:
            self._memories.release(executor)
            if executor.stream is not None:
                self._followed.discard(executor.stream)
            await executor.close()

    def _follow(
        self, stream: SecureStream[Identity], remote: Endpoint, fields: Mapping[str, bytes]
    ) -> None:
        api = self._agent.endpoints.api_of(remote)
        if api is not None and "topic" in fields:
            self._followed.add(stream, text(fields, "topic"), api)

    async def leave_publishers(self) -> None:
        """Periodically leave what the master lists no longer, until cancelled."""
        while True:
            await asyncio.sleep(PERIOD)
            self._followed.leave_unlisted()

    def _topic_ended(self, fields: Mapping[str, bytes], began: float) -> None:
        """A connection with this header has ended, or could not be made; of a service: nothing."""
        if "topic" in fields:
            self._on_topic_ended(text(fields, "topic"), began)

    async def _forward(
        self,
        admitted: AdmittedConnection,
        program: PlainStream,
        stream: SecureStream[Identity],
        after_request: bytes,
        after_answer: bytes,
    ) -> None:
        guard = None if admitted.guard is None else ReplaceableGuard(admitted.guard)
        replacing = Replacing(guard, admitted.rebuild, to_peer=False)
        connection = AuthorizedConnection(
            stream, admitted.decision, admitted.guard, replacing.rebuild, replacing.swap
        )
        with self._connections.track(connection), pump.log_end(shown(stream.peer.name)):
            await program.send(header.encode(admitted.answer))
            if admitted.service:
                await pump.exchange(program, stream, after_request, after_answer)
            else:
                stream.raise_unit_limit(unit_limit(admitted.message_size, MESSAGE_LIMIT))
                max_length = message_limit(admitted.message_size, MESSAGE_LIMIT)
                await pump.subscribe(program, stream, guard, after_answer, max_length)
