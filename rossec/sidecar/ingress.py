"""Doors to the network: peers call a program's slave API, subscribe to its topics, call services.

A shell. Each connection runs one layer after another; whatever goes wrong ends that connection, on
both sides. A peer that is refused is told why its own grants do not suffice, and no more.
"""

import asyncio
import contextlib
import logging
from collections.abc import Callable
from typing import Final

from ca.certificates import Identity
from ca.errors import HintedError
from rossec import clock
from rossec.channel.opening import WireProtocol
from rossec.errors import CallRefused, HangUp
from rossec.net.aio import SecureStream
from rossec.net.aio.server import SecureServer
from rossec.net.aio.tasks import TaskSet
from rossec.net.rpc.client import serve_calls
from rossec.participant import slave_api
from rossec.participant.connections import AcceptedConnections
from rossec.participant.limit_memory import recall
from rossec.participant.slave_rights import MASTER
from rossec.participant.topic_guard import FilterKey
from rossec.ros import header
from rossec.sidecar import pump
from rossec.sidecar.connector import PeerConnector
from rossec.sidecar.core import slave_calls, tcpros
from rossec.sidecar.core.copies import Copies
from rossec.sidecar.core.endpoints import Endpoint
from rossec.sidecar.core.layers import AgentState
from rossec.sidecar.core.program_memory import ProgramMemories
from rossec.sidecar.core.tcpros import AdmittedConnection
from rossec.sidecar.executor import AgentServices, CommandExecutor
from rossec.sidecar.peer_connections import PeerConnections
from rossec.sidecar.plain_stream import PlainStream
from rossec.sidecar.port_pool import PortPool
from rossec.sidecar.pump import split_header

HEADER_DEADLINE: Final = 15.0  # the program's side of it may have to be reached first
REVOCATION_UPDATE: Final = "rossec.revocationUpdate"

_log = logging.getLogger("rossec.sidecar")
News = Callable[[bytes, bytes, Identity], None]


class Ingress:
    """The doors of one identity.

    Args:
        house: whom visits are made for.
        filter_key: finds a key for pseudonyms by its name.
        news: takes a list of revocations and a timestamp from the master.
    """

    def __init__(
        self,
        house: AgentServices,
        tenant: AgentState,
        network: PeerConnector,
        links: PeerConnections,
        guests: AcceptedConnections,
        filter_key: FilterKey,
        news: News,
    ) -> None:
        self._house = house
        self._tenant = tenant
        self._network = network
        self._links = links
        self._filter_key = filter_key
        self._news = news
        self._tasks = TaskSet()
        self._guests = guests
        self._copies = Copies()
        self._places = ProgramMemories(recall(tenant.identity.name), self._is_dead)
        self.doorways = PortPool(self._close_door, self._is_dead)

    def open(self, local: Endpoint) -> int:
        """The port outside for `local`."""
        server = self.doorways.ask(local, lambda: self._open_door(local))
        server.wake()
        return server.port

    def rest(self, local: Endpoint) -> None:
        """Refuse callers for `local`: the program is gone."""
        server = self.doorways.get(local)
        if server is not None:
            server.rest()

    async def close(self) -> None:
        """Close every door."""
        for server in self.doorways:
            await server.close()
        await self._tasks.close()

    def _open_door(self, local: Endpoint) -> SecureServer[Identity]:
        serve = self._admit if local.flavour is WireProtocol.TCPROS else self._answer

        async def handler(stream: SecureStream[Identity]) -> None:
            with contextlib.suppress(TimeoutError):
                await serve(local, stream)

        host = self._tenant.doors.host
        return self._network.listen(self._guests.bounded(handler), host, local.flavour)

    def _close_door(self, local: Endpoint, server: SecureServer[Identity]) -> None:
        self._tenant.doors.closed_outside(local, server.port)
        self._tenant.forget(local)
        self._tasks.spawn(server.close(), f"the door for {local.uri}")

    def _is_dead(self, local: Endpoint) -> bool:
        return not self._house.callers.listeners(local.port)

    # --- XML-RPC

    async def _answer(self, local: Endpoint, stream: SecureStream[Identity]) -> None:
        """A peer's calls to a program's slave API."""
        shown: list[bytes] = []
        visit = CommandExecutor(self._house)

        async def dispatch(method: str, params: tuple[object, ...], peer: Identity) -> object:
            try:
                match method, params:
                    case "rossec.revocationUpdate", (_, bytes() as data, bytes() as timestamp):
                        return self._take_revocations(peer, data, timestamp)
                    case "rossec.presentGrants", (_, bytes() as grants):
                        shown[:] = [grants]
                    case _:
                        pass
                now = clock.now()
                proof = shown[0] if shown else None
                tenant = self._tenant
                layer = slave_calls.ask_program(tenant, local, peer, method, params, proof, now)
                return await visit.run(layer)
            except HangUp:
                raise
            except HintedError as error:
                _log.warning("refused %s: %s (%s)", peer.name, error, error.hint)
                return [-1, f"rossec: {error}", 0]

        try:
            async with asyncio.timeout(None if stream.peer.name == MASTER else slave_api.DEADLINE):
                await serve_calls(stream, dispatch)
        finally:
            await visit.close()

    def _take_revocations(self, peer: Identity, data: bytes, timestamp: bytes) -> object:
        if peer.name != MASTER:
            raise CallRefused(f"{REVOCATION_UPDATE} is for the master alone")
        self._news(data, timestamp, peer)
        return [1, "", 0]

    # --- TCPROS

    async def _admit(self, local: Endpoint, stream: SecureStream[Identity]) -> None:
        """A peer that subscribes to a program's topic, or calls its service."""
        visit = CommandExecutor(self._house)
        try:
            try:
                async with asyncio.timeout(HEADER_DEADLINE):
                    fields, early = await split_header(stream)
                    layer = tcpros.admit_peer(
                        self._tenant, local, fields, stream.peer, self._filter_key,
                        lambda name: self._places.take(name, local), clock.now(),
                    )  # fmt: skip
                    joined = await visit.run(layer)
            except HangUp:
                raise
            except HintedError as error:
                _log.warning("refused %s: %s (%s)", stream.peer.name, error, error.hint)
                await stream.send(header.error_header(f"rossec: {error}"))
                return
            if visit.program is not None:
                await self._pass(joined, visit.program, stream, early, visit.first)
        except HangUp as error:
            _log.info("%s: %s", stream.peer.name, error)
        finally:
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
            await stream.send(header.encode(joined.answer))
            if joined.service:
                stream.welcome()
                await pump.exchange(program, stream, first, early)
            elif early:
                _log.warning("%s sends data where it subscribes", stream.peer.name)
            else:
                now, latching = clock.now(), joined.latching
                with self._copies.shared(joined.guard, now, latching=latching) as (judge, shown):
                    if shown:
                        await stream.send(*pump.framed(shown))
                    await pump.publish(program, stream, judge, first)
