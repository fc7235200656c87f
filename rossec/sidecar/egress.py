"""Loopback ports for peers: programs call a peer's slave API, subscribe to topics, call services. A shell.

Each connection runs one layer after another; an error closes that connection on both sides.
"""

import asyncio
import logging
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Final, Generic, TypeVar

from ca.bounded import ExpiringTable
from ca.certificates import Identity
from ca.errors import HintedError
from ca.names import shown
from grants.model import Right
from grants.request import MissingRight, is_dispensable, missing_right, refusal
from rossec import clock, errors
from rossec.channel.opening import WireProtocol
from rossec.host import local_ports, runner
from rossec.net.aio import SecureStream
from rossec.net.limits import message_limit, unit_limit
from rossec.net.rpc import serve_calls
from rossec.participant.authorized import AuthorizedConnection, memory_scope
from rossec.participant.connections import ConnectionTable, FollowedPublishers
from rossec.participant.definitions import FilterKey
from rossec.participant.handshakes import text
from rossec.participant.registrations import REFUSED, nothing_shown, shows_nothing, unheard_refusal
from rossec.peer_limits import printable
from rossec.ros import tcpros
from rossec.sidecar import pump
from rossec.sidecar.core import node_connections
from rossec.sidecar.core.guards import ProgramMemories, ReplaceableGuard, Replacing
from rossec.sidecar.core.layers import AgentState, ListeningAddress
from rossec.sidecar.core.node_connections import AdmittedConnection
from rossec.sidecar.executor import AgentServices, CommandExecutor
from rossec.sidecar.loopback_port import LoopbackPort, PlainStream

T = TypeVar("T")
_log = logging.getLogger("rossec.sidecar")
_WHERE: Final = "is ROS_IP or ROS_HOSTNAME right on its side, and its name known on this host?"
COLLECTED_FOR: Final = 1.0  # seconds
SAID_FOR: Final = 3600.0
_REMEMBERED: Final = 1024
_LINE: Final = 2000  # characters
HEADER_DEADLINE: Final = 15.0  # includes the handshake with the peer


class Said(Generic[T]):
    """What was said within the last hour."""

    def __init__(self, now: Callable[[], float]) -> None:
        self._now = now
        self._said: ExpiringTable[T, bool] = ExpiringTable(_REMEMBERED, SAID_FOR)

    def add(self, what: T) -> bool:
        now = self._now()
        if self._said.get(what, now):
            return False
        self._said.put(what, True, now)
        return True


class MissingRights:
    """What the programs of one identity asked for and no grant gives, as lines that say what is missing."""

    def __init__(self, now: Callable[[], float]) -> None:
        self._said = Said[MissingRight](now)
        self._new: list[MissingRight] = []

    def add(self, missing: MissingRight) -> bool:
        # What a client library asks for by itself is no warning: the program works without it.
        if is_dispensable(missing.right, missing.own) or not self._said.add(missing):
            return False
        self._new.append(missing)
        return True

    def take(self) -> list[str]:
        # One line for each node of what is new since the last call.
        nodes: dict[str, list[tuple[Right, str]]] = {}
        for each in self._new:
            nodes.setdefault(each.node, []).append((each.right, each.in_rule))
        self._new = []
        return [refusal(node, found) for node, found in nodes.items()]


class RefusalLog:
    def __init__(self) -> None:
        self._missing = MissingRights(clock.counter())
        self._reasons, self._paths = Said[str](clock.counter()), Said[str](clock.counter())
        self._timer: asyncio.TimerHandle | None = None

    def log(self, refuser: str, method: str, answer: object, params: Sequence[object] = ()) -> None:
        # Of an answer in which rossec refuses a call, or that does not reach the program.
        match answer:
            case [code, str(status), *_] if code != 1 and status.startswith(REFUSED):
                missing = missing_right(status)
                if missing is None:
                    self._refused(refuser, method, status.removeprefix(REFUSED))
                elif self._missing.add(missing) and self._timer is None:
                    # A program asks for much at its start: that is one line.
                    loop = asyncio.get_running_loop()
                    self._timer = loop.call_later(COLLECTED_FOR, self.flush)
            case _ if (reason := unheard_refusal(method, params, answer)) is not None:
                self._refused(refuser, method, reason)
            case _:
                pass

    def log_own(self, node: str, method: str, answer: object) -> None:
        # Of an answer that the sidecar itself gives; what the master refused went through `log`.
        match answer:
            case [-1, str(status), *_] if status.startswith(REFUSED):
                if missing_right(status) is None:
                    self._refused(f"the sidecar of {node}", method, status.removeprefix(REFUSED))
            case _ if shows_nothing(method, answer):
                text = nothing_shown(node)
                if self._reasons.add(text):
                    _log.warning("%s: %s", method, printable(text))
            case _:
                pass

    def _refused(self, refuser: str, method: str, reason: str) -> None:
        if self._reasons.add(reason):
            _log.warning("%s refuses %s: %s", refuser, method, printable(reason, _LINE))

    def unreachable(self, peer: str, error: errors.PeerUnreachable) -> None:
        # The program sees a closed connection, and tries again in silence.
        if isinstance(error.__cause__, ConnectionRefusedError) or not self._paths.add(peer):
            return
        _log.warning("%s is out of reach: %s (%s)", printable(peer), printable(str(error)), _WHERE)

    def flush(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        for line in self._missing.take():
            _log.warning("%s", printable(line, _LINE))


class Egress:
    """The loopback ports of one identity; `on_topic_ended`: a topic, and when its connection began."""

    def __init__(
        self,
        services: AgentServices,
        agent: AgentState,
        connections: ConnectionTable[SecureStream[Identity]],
        filter_key: FilterKey,
        on_topic_ended: Callable[[str, float], None],
    ) -> None:
        self._services, self._agent, self._connections = services, agent, connections
        self._filter_key, self._on_topic_ended = filter_key, on_topic_ended
        self._tasks = runner.TaskSet()
        self._refusals = RefusalLog()
        self._memories: ProgramMemories[CommandExecutor] = ProgramMemories(memory_scope(agent.identity.name))
        self.followed: FollowedPublishers[ListeningAddress] = FollowedPublishers(agent.is_listed)
        self.ports = local_ports.PortPool(self._close_port)

    def open(self, remote: ListeningAddress) -> int:
        listener = self._port_for(remote)
        listener.open()
        return listener.port

    def refuse(self, remote: ListeningAddress) -> int:
        listener = self._port_for(remote)
        listener.suspend()
        return listener.port

    async def close(self) -> None:
        self._refusals.flush()
        for listener in self.ports:
            await listener.close()
        await self._tasks.close()

    def _port_for(self, remote: ListeningAddress) -> LoopbackPort:
        serve = self._serve_tcpros if remote.protocol is WireProtocol.TCPROS else self._serve_slave_api

        async def handler(program: PlainStream) -> None:
            await serve(remote, program)

        callers = self._services.callers
        return self.ports.get_or_open(remote, lambda: LoopbackPort(callers, handler))

    def _close_port(self, _: ListeningAddress, listener: LoopbackPort) -> None:
        self._agent.endpoints.remove_egress(listener.port)
        self._tasks.spawn(listener.close(), f"loopback port {listener.port}")

    async def _serve_slave_api(self, remote: ListeningAddress, program: PlainStream) -> None:
        executor = CommandExecutor(self._services)

        async def dispatch(method: str, params: tuple[object, ...], _: str) -> object:
            layer = node_connections.handle_program_call(self._agent, remote, method, params)
            answer = await executor.run(layer)
            # A program may not print it: rosnode says "killed" whatever a node answers.
            self._refusals.log(remote.uri, method, answer)
            return answer

        try:
            await serve_calls(program, dispatch, compact=False)
        finally:
            await executor.close()

    async def _serve_tcpros(self, remote: ListeningAddress, program: PlainStream) -> None:
        executor = CommandExecutor(self._services)
        fields: Mapping[str, bytes] = {}
        began = time.monotonic()
        try:
            try:
                async with asyncio.timeout(HEADER_DEADLINE):
                    fields, after_request = await pump.split_header(program)
                    layer = node_connections.connect_to_peer(
                        self._agent,
                        remote,
                        fields,
                        self._filter_key,
                        lambda name: self._memories.acquire(name, executor),
                        clock.now(),
                    )
                    admitted = await executor.run(layer)
            except errors.HangUp as error:
                _log.info("no connection to %s: %s", remote.uri, error)
                self._topic_ended(fields, began)  # rospy would give it up
                return
            except HintedError as error:
                _log.warning("no connection to %s: %s (%s)", remote.uri, error, error.hint)
                await program.send(tcpros.error_header(f"rossec: {error}"))
                await program.close()
                return
            if executor.stream is not None:
                began = time.monotonic()
                api = self._agent.endpoints.api_of(remote)
                if api is not None and "topic" in fields:
                    self.followed.add(executor.stream, text(fields, "topic"), api)
                await self._forward(admitted, program, executor.stream, after_request, executor.after_header)
                self._topic_ended(fields, began)
        except (errors.RossecError, TimeoutError) as error:
            _log.info("a connection to %s ended: %s", remote.uri, error)
        finally:
            self._memories.release(executor)
            if executor.stream is not None:
                self.followed.discard(executor.stream)
            await executor.close()

    def _topic_ended(self, fields: Mapping[str, bytes], began: float) -> None:
        # A connection with this header has ended, or could not be made; of a service: nothing.
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
            await program.send(tcpros.encode(admitted.answer))
            if admitted.service:
                await pump.exchange(program, stream, after_request, after_answer)
            else:
                stream.raise_unit_limit(unit_limit(admitted.message_size, tcpros.MESSAGE_LIMIT))
                max_length = message_limit(admitted.message_size, tcpros.MESSAGE_LIMIT)
                await pump.subscribe(program, stream, guard, after_answer, max_length)
