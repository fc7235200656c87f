"""Executes the commands of one connection's layers, and owns the connections this opens.

A shell: it connects, calls and reports; it decides nothing. A peer is checked before anything is
sent to it, and a program that listens before it is connected to.
"""

import asyncio
import contextlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final, Protocol, assert_never

from ca.certificates import Identity
from ca.errors import HintedError
from grants.model import Right
from rossec import clock
from rossec.channel.opening import WireProtocol
from rossec.errors import PeerUnreachable, RossecError, XmlRpcRefused
from rossec.net.aio.dial import dial
from rossec.net.aio.stream import SecureStream
from rossec.net.host.peeruid import Holder
from rossec.net.rpc.client import RpcClient
from rossec.ros import header
from rossec.ros.names import PRESENT_GRANTS
from rossec.ros.xmlrpc import FAULT_CODE, Fault
from rossec.sidecar.callers import Callers
from rossec.sidecar.core.commands import (
    AuthenticatePeer,
    CallMaster,
    CallPeer,
    CallProgram,
    Command,
    ConnectPeer,
    ConnectProgram,
    OpenEgress,
    OpenIngress,
    Probe,
    Request,
    Suspend,
)
from rossec.sidecar.core.endpoints import Endpoint
from rossec.sidecar.core.events import (
    Answered,
    CommandDone,
    Event,
    HeaderArrived,
    NoAnswer,
    Opened,
    PeerAuthenticated,
    RawResponse,
)
from rossec.sidecar.core.layers import Layer, Outcome
from rossec.sidecar.plain_stream import PlainStream
from rossec.sidecar.pump import split_header

DEADLINE: Final = 10.0


@dataclass
class SlaveApiClient:
    """A connection to a peer's slave API; `presented`: the rights whose grants were presented."""

    rpc: RpcClient
    peer: Identity
    presented: set[Right] = field(default_factory=set)

    @property
    def usable(self) -> bool:
        """Whether it is still open."""
        return not self.rpc.closed


class AgentServices(Protocol):
    """The services that an executor needs of its agent."""

    @property
    def name(self) -> str:
        """Its certified name."""

    @property
    def callers(self) -> Callers:
        """The programs that may be connected to."""

    def open_ingress(self, local: Endpoint) -> int:
        """The network port for `local`; it listens."""

    def suspend_ingress(self, local: Endpoint) -> None:
        """Refuse callers for `local`."""

    def leads_to(self, local: Endpoint, listeners: list[Holder]) -> bool:
        """Whether `listeners` are the program that the port of `local` was opened for."""

    def open_egress(self, remote: Endpoint) -> int:
        """The loopback port for `remote`; it listens."""

    def refuse_egress(self, remote: Endpoint) -> int:
        """The loopback port for `remote`; it refuses callers."""

    def cache_client(self, remote: Endpoint, client: SlaveApiClient) -> None:
        """Cache a connection for the next caller of `remote`."""

    def cached_client(self, remote: Endpoint) -> SlaveApiClient | None:
        """Take a cached connection to `remote`."""

    async def dial(self, remote: Endpoint) -> SecureStream[Identity]:
        """Connect to a peer with a valid identity."""

    def note_unreachable(self, remote: Endpoint, error: PeerUnreachable) -> None:
        """Say that no connection to a peer could be made."""

    def check_peer(self, peer: Identity) -> None:
        """Return if the identity of `peer` is still valid. Raises a `HintedError`."""

    async def call_master(self, method: str, params: tuple[object, ...]) -> object:
        """The master's answer."""

    def proof(self, right: Right, name: str) -> bytes:
        """The grants for `right` on `name`."""


class CommandExecutor:
    """Executes commands for one connection.

    Attributes:
        program, stream: the TCPROS connection to a program or to a peer.
        after_header: the bytes it sent after its header.
    """

    def __init__(self, services: AgentServices) -> None:
        self._services = services
        self._program_rpc: RpcClient | None = None
        self._peer_client: SlaveApiClient | None = None
        self.program: PlainStream | None = None
        self.stream: SecureStream[Identity] | None = None
        self.after_header = b""

    async def run(self, layer: Layer[Outcome]) -> Outcome:
        """Run a layer to its end."""
        try:
            command = next(layer)
            while True:
                try:
                    event = await self._execute(command)
                except Fault as fault:  # a valid answer; in a multicall that of one element
                    command = layer.throw(fault)
                else:
                    command = layer.send(event)
        except StopIteration as done:
            outcome: Outcome = done.value
            return outcome

    async def close(self) -> None:
        """Close everything that is open."""
        await self._close_program_rpc()
        if self._peer_client is not None:
            with contextlib.suppress(RossecError, OSError):
                await self._peer_client.rpc.close()
        if self.program is not None:
            self.program.abort()
        if self.stream is not None:
            self.stream.abort("the other end was closed")

    async def _close_program_rpc(self) -> None:
        """Close the connection to a program's slave API: a TCPROS connection may last for days."""
        rpc, self._program_rpc = self._program_rpc, None
        if rpc is not None:
            with contextlib.suppress(RossecError, OSError):
                await rpc.close()

    async def _execute(self, command: Command) -> Event:
        match command:
            case OpenIngress(local):
                return Opened(self._services.open_ingress(local))
            case OpenEgress(remote, probe):
                return Opened(
                    await self._probe_egress(remote)
                    if probe
                    else self._services.open_egress(remote)
                )
            case Suspend(local):
                self._services.suspend_ingress(local)
                return CommandDone()
            case _:
                return await self._execute_request(command)

    async def _execute_request(self, request: Request) -> Event:
        try:
            async with asyncio.timeout(DEADLINE):
                return await self._perform(request)
        except ConnectionRefusedError as error:
            return NoAnswer(str(error), dead=True)
        except XmlRpcRefused as error:  # an answer, or the program would call again for ever
            raise Fault(FAULT_CODE, f"rossec: {error}") from error
        except (HintedError, OSError, TimeoutError) as error:
            return NoAnswer(str(error) or "no answer in time")

    async def _perform(self, request: Request) -> Event:
        match request:
            case CallMaster(method, params):
                return Answered(await self._services.call_master(method, params))
            case CallProgram(local, method, params):
                return await _call(await self._rpc_to_program(local), method, params, parse=True)
            case CallPeer(remote, method, params, right, parse):
                client = await self._client_of_peer(remote, right)
                event = await _call(client.rpc, method, params, parse=parse)
                return replace(event, peer=client.peer) if isinstance(event, Answered) else event
            case Probe(local):
                await self._rpc_to_program(local)
                return CommandDone()
            case AuthenticatePeer(remote):
                return PeerAuthenticated(await self._authenticate(remote))
            case ConnectProgram() | ConnectPeer():
                return await self._connect(request)
            case _:
                assert_never(request)

    async def _connect(self, request: ConnectProgram | ConnectPeer) -> Event:
        if isinstance(request, ConnectPeer):
            stream = await self._stream_to(request.remote)
            return await self._exchange_headers(stream, stream.peer, request.fields)
        await self._close_program_rpc()
        self.program = await self._connect_program(request.local)
        return await self._exchange_headers(self.program, None, request.fields)

    async def _authenticate(self, remote: Endpoint) -> Identity:
        if remote.protocol is WireProtocol.HTTP:
            return (await self._client_of_peer(remote, None)).peer
        return (await self._stream_to(remote)).peer

    async def _stream_to(self, remote: Endpoint) -> SecureStream[Identity]:
        """The TCPROS connection to the peer there, which a layer makes one of."""
        if self.stream is None:
            try:
                self.stream = await self._services.dial(remote)
            except PeerUnreachable as error:
                self._services.note_unreachable(remote, error)
                raise
        return self.stream

    async def _exchange_headers(
        self,
        end: PlainStream | SecureStream[Identity],
        peer: Identity | None,
        fields: Mapping[str, bytes],
    ) -> Event:
        await end.send(header.encode(fields))
        answer, self.after_header = await split_header(end)
        return HeaderArrived(answer, peer, clock.now())

    async def _rpc_to_program(self, local: Endpoint) -> RpcClient:
        if self._program_rpc is None or self._program_rpc.closed:
            self._program_rpc = RpcClient(
                await self._connect_program(local),
                host=self._services.callers.loopback.host,
                compact=False,
            )
        return self._program_rpc

    async def _connect_program(self, local: Endpoint) -> PlainStream:
        callers = self._services.callers
        holders = await callers.check_listener(local.port)
        if not self._services.leads_to(local, holders):
            raise ConnectionRefusedError(f"another program has port {local.port} now")
        sock = await dial(callers.loopback.address, local.port, DEADLINE)
        try:
            callers.check_unchanged(local.port, holders)
        except BaseException:
            sock.close()
            raise
        return PlainStream(sock)

    async def _probe_egress(self, remote: Endpoint) -> int:
        """Open a port only if the peer answers; its connection is cached for the next caller."""
        try:
            async with asyncio.timeout(DEADLINE):
                client = await self._connect_peer(remote)
                await self._present_grants(client, Right.GRAPH)
        except (RossecError, OSError, TimeoutError):
            return self._no_answer(remote)
        self._services.cache_client(remote, client)
        return self._services.open_egress(remote)

    def _no_answer(self, remote: Endpoint) -> int:
        """The port of a peer that does not answer: it refuses callers, as that of a dead node.

        One behind a door may be out of reach for a while, and programs that were refused never try
        again: they are admitted and hung up on.
        """
        services = self._services
        return services.open_egress(remote) if remote.door else services.refuse_egress(remote)

    async def _client_of_peer(self, remote: Endpoint, right: Right | None) -> SlaveApiClient:
        if self._peer_client is None or not self._peer_client.usable:
            self._peer_client = self._services.cached_client(remote)
        if self._peer_client is None or not self._peer_client.usable:
            self._peer_client = await self._connect_peer(remote)
        self._services.check_peer(self._peer_client.peer)  # connected long ago, perhaps
        if right is not None and right not in self._peer_client.presented:
            await self._present_grants(self._peer_client, right)
        return self._peer_client

    async def _connect_peer(self, remote: Endpoint) -> SlaveApiClient:
        try:
            stream = await self._services.dial(remote)
        except PeerUnreachable as error:
            self._services.note_unreachable(remote, error)
            self._no_answer(remote)
            raise
        return SlaveApiClient(RpcClient(stream), stream.peer)

    async def _present_grants(self, client: SlaveApiClient, right: Right) -> None:
        """Present grants; the answer to the call itself says whether they suffice."""
        grants = self._services.proof(right, client.peer.name)
        with contextlib.suppress(Fault):
            await client.rpc.call(PRESENT_GRANTS, self._services.name, grants)
        client.presented.add(right)


async def _call(rpc: RpcClient, method: str, params: tuple[object, ...], *, parse: bool) -> Event:
    if parse:
        return Answered(await rpc.call(method, *params))
    return RawResponse(await rpc.fetch(method, *params))


async def run_layer(services: AgentServices, layer: Layer[Outcome]) -> Outcome:
    """Run one layer; the connections it opens are closed at its end."""
    executor = CommandExecutor(services)
    try:
        return await executor.run(layer)
    finally:
        await executor.close()
