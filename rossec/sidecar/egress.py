"""Doors on loopback: programs call a peer's slave API, subscribe to its topics, call services.

A shell. Each connection runs one layer after another; whatever goes wrong ends that connection, on
both sides.
"""

import asyncio
import logging
import time
from collections.abc import Callable
from typing import Final

from ca.certificates import Identity
from ca.errors import HintedError
from rossec import clock
from rossec.channel.opening import WireProtocol
from rossec.channel.records import ChannelLimits
from rossec.errors import HangUp, RossecError
from rossec.net.aio import SecureStream
from rossec.net.aio.tasks import TaskSet
from rossec.net.bounds import message_limit, unit_limit
from rossec.net.rpc.client import serve_calls
from rossec.participant.header_fields import text
from rossec.participant.limit_memory import recall
from rossec.participant.topic_guard import FilterKey
from rossec.ros import header
from rossec.ros.header import MESSAGE_LIMIT
from rossec.sidecar import pump
from rossec.sidecar.core import slave_calls, tcpros
from rossec.sidecar.core.endpoints import Endpoint
from rossec.sidecar.core.layers import AgentState
from rossec.sidecar.core.program_memory import ProgramMemories
from rossec.sidecar.core.tcpros import AdmittedConnection
from rossec.sidecar.executor import AgentServices, CommandExecutor
from rossec.sidecar.loopback_port import LoopbackPort
from rossec.sidecar.peer_connections import PeerConnections
from rossec.sidecar.plain_stream import PlainStream
from rossec.sidecar.port_pool import PortPool
from rossec.sidecar.pump import split_header

HEADER_DEADLINE: Final = 15.0  # the peer's side of it has to be reached first

_log = logging.getLogger("rossec.sidecar")


class Egress:
    """The doors of one identity.

    Args:
        house: whom visits are made for.
        filter_key: finds a key for pseudonyms by its name.
        ended: told of a topic whose connection, made at that monotonic time, has ended.
    """

    def __init__(
        self,
        house: AgentServices,
        tenant: AgentState,
        links: PeerConnections,
        filter_key: FilterKey,
        ended: Callable[[str, float], None],
    ) -> None:
        self._house = house
        self._tenant = tenant
        self._links = links
        self._filter_key = filter_key
        self._ended = ended
        self._tasks = TaskSet()
        self._places: ProgramMemories[CommandExecutor] = ProgramMemories(
            recall(tenant.identity.name)
        )
        self.doorways = PortPool(self._close_door)

    def open(self, remote: Endpoint) -> int:
        """The loopback port for `remote`; it listens."""
        door = self._door(remote)
        door.open()
        return door.port

    def rest(self, remote: Endpoint) -> int:
        """The loopback port for `remote`; it refuses callers."""
        door = self._door(remote)
        door.rest()
        return door.port

    async def close(self) -> None:
        """Close every door."""
        for door in self.doorways:
            await door.close()
        await self._tasks.close()

    def _door(self, remote: Endpoint) -> LoopbackPort:
        serve = self._reach if remote.flavour is WireProtocol.TCPROS else self._inquire

        async def handler(program: PlainStream) -> None:
            await serve(remote, program)

        callers = self._house.callers
        return self.doorways.ask(remote, lambda: LoopbackPort(callers, handler))

    def _close_door(self, _: Endpoint, door: LoopbackPort) -> None:
        self._tenant.doors.closed_inside(door.port)
        self._tasks.spawn(door.close(), f"loopback port {door.port}")

    async def _inquire(self, remote: Endpoint, program: PlainStream) -> None:
        """A program's calls to a peer's slave API."""
        visit = CommandExecutor(self._house)

        async def dispatch(method: str, params: tuple[object, ...], _: str) -> object:
            return await visit.run(slave_calls.ask_peer(self._tenant, remote, method, params))

        try:
            await serve_calls(program, dispatch)
        finally:
            await visit.close()

    async def _reach(self, remote: Endpoint, program: PlainStream) -> None:
        """A program that subscribes to a peer's topic, or calls its service."""
        visit = CommandExecutor(self._house)
        try:
            try:
                async with asyncio.timeout(HEADER_DEADLINE):
                    fields, early = await split_header(program)
                    layer = tcpros.reach_peer(
                        self._tenant, remote, fields, self._filter_key,
                        lambda name: self._places.take(name, visit), clock.now(),
                    )  # fmt: skip
                    joined = await visit.run(layer)
            except HangUp as error:
                _log.info("no connection to %s: %s", remote.uri, error)
                return
            except HintedError as error:
                _log.warning("no connection to %s: %s (%s)", remote.uri, error, error.hint)
                await program.send(header.error_header(f"rossec: {error}"))
                await program.close()
                return
            if visit.stream is not None:
                began = time.monotonic()
                await self._pass(joined, program, visit.stream, early, visit.first)
                if not joined.service:
                    self._ended(text(fields, "topic"), began)
        except (RossecError, TimeoutError) as error:
            _log.info("a connection to %s ended: %s", remote.uri, error)
        finally:
            self._places.leave(visit)
            await visit.close()

    async def _pass(
        self,
        joined: AdmittedConnection,
        program: PlainStream,
        stream: SecureStream[Identity],
        early: bytes,
        first: bytes,
    ) -> None:
        with self._links.linked(stream, joined.decision):
            await program.send(header.encode(joined.answer))
            if joined.service:
                await pump.exchange(program, stream, early, first)
            else:
                stream.raise_unit_limit(unit_limit(joined.size, ChannelLimits.unit))
                longest = message_limit(joined.size, MESSAGE_LIMIT)
                await pump.subscribe(program, stream, joined.guard, first, longest)
