"""Executes the commands of one connection's layers, and owns the connections this opens.

A shell: it connects, calls and reports; it decides nothing.
"""

import asyncio
import contextlib
from dataclasses import dataclass, field
from typing import Final, Protocol, assert_never

from ca.certificates import Identity
from ca.errors import HintedError
from grants.model import Right
from rossec import clock
from rossec.channel.opening import WireProtocol
from rossec.errors import PeerUnreachable, RossecError, XmlRpcRefused
from rossec.host.callers import Callers
from rossec.host.local_sockets import Holder
from rossec.net.aio.client import dial
from rossec.net.aio.stream import SecureStream
from rossec.net.rpc import RpcClient
from rossec.ros import names, tcpros, xmlrpc
from rossec.sidecar import loopback_port, pump
from rossec.sidecar.core import layers

DEADLINE: Final = 10.0


@dataclass
class SlaveApiClient:
    rpc: RpcClient
    peer: Identity
    presented: set[Right] = field(default_factory=set)

    @property
    def usable(self) -> bool:
        return not self.rpc.closed


class AgentServices(Protocol):
    @property
    def name(self) -> str: ...
    @property
    def callers(self) -> Callers: ...
    def open_ingress(self, local: layers.ListeningAddress) -> int: ...
    def suspend_ingress(self, local: layers.ListeningAddress) -> None: ...
    def leads_to(self, local: layers.ListeningAddress, listeners: list[Holder]) -> bool: ...
    def open_egress(self, remote: layers.ListeningAddress) -> int: ...
    def refuse_egress(self, remote: layers.ListeningAddress) -> int: ...
    def cache_client(self, remote: layers.ListeningAddress, client: SlaveApiClient) -> None: ...
    def cached_client(self, remote: layers.ListeningAddress) -> SlaveApiClient | None: ...
    async def dial(self, remote: layers.ListeningAddress) -> SecureStream[Identity]: ...
    def note_unreachable(self, remote: layers.ListeningAddress, error: PeerUnreachable) -> None: ...
    def check_peer(self, peer: Identity) -> None: ...
    async def call_master(self, method: str, params: tuple[object, ...]) -> object: ...
    def proof(self, right: Right, name: str) -> bytes: ...


class CommandExecutor:
    """Executes commands for one connection."""

    def __init__(self, services: AgentServices) -> None:
        self._services = services
        self._program_rpc: RpcClient | None = None
        self._peer_client: SlaveApiClient | None = None
        self.program: loopback_port.PlainStream | None = None  # the TCPROS connection to a program,
        self.stream: SecureStream[Identity] | None = None  # or to a peer
        self.after_header = b""  # the bytes it sent after its header

    async def run(self, layer: layers.Layer[layers.Outcome]) -> layers.Outcome:
        try:
            command = next(layer)
            while True:
                try:
                    event = await self._execute(command)
                except xmlrpc.Fault as fault:  # a valid answer; in a multicall that of one element
                    command = layer.throw(fault)
                else:
                    command = layer.send(event)
        except StopIteration as done:
            outcome: layers.Outcome = done.value
            return outcome

    async def close(self) -> None:
        await self._close_program_rpc()
        if self._peer_client is not None:
            with contextlib.suppress(RossecError, OSError):
                await self._peer_client.rpc.close()
        if self.program is not None:
            self.program.abort()
        if self.stream is not None:
            self.stream.abort("the other end was closed")

    async def _close_program_rpc(self) -> None:
        rpc, self._program_rpc = self._program_rpc, None
        if rpc is not None:
            with contextlib.suppress(RossecError, OSError):
                await rpc.close()

    async def _execute(self, command: layers.Command) -> layers.Event:
        match command:
            case layers.OpenIngress(local):
                return layers.PortOpened(self._services.open_ingress(local))
            case layers.OpenEgress(remote, probe):
                return layers.PortOpened(
                    await self._probe_egress(remote) if probe else self._services.open_egress(remote)
                )
            case layers.Suspend(local):
                self._services.suspend_ingress(local)
                return layers.CommandDone()
            case _:
                pass
        try:
            async with asyncio.timeout(DEADLINE):
                return await self._perform(command)
        except ConnectionRefusedError as error:
            return layers.NoAnswer(str(error), dead=True)
        except XmlRpcRefused as error:  # an answer, or the program would call again for ever
            raise xmlrpc.Fault(xmlrpc.FAULT_CODE, f"rossec: {error}") from error
        except (HintedError, OSError, TimeoutError) as error:
            return layers.NoAnswer(str(error) or "no answer in time")

    async def _perform(self, request: layers.Request) -> layers.Event:
        match request:
            case layers.CallMaster(method, params):
                return layers.Answered(await self._services.call_master(method, params))
            case layers.CallProgram(local, method, params):
                return await _call(await self._rpc_to_program(local), method, params, parse=True)
            case layers.CallPeer(remote, method, params, right, parse):
                client = await self._client_of_peer(remote, right)
                event = await _call(client.rpc, method, params, parse=parse)
                return event._replace(peer=client.peer) if isinstance(event, layers.Answered) else event
            case layers.Probe(local):
                await self._rpc_to_program(local)
                return layers.CommandDone()
            case layers.AuthenticatePeer(remote):
                is_http = remote.protocol is WireProtocol.HTTP
                end = await (self._client_of_peer(remote, None) if is_http else self._stream_to(remote))
                return layers.PeerAuthenticated(end.peer)
            case layers.ConnectProgram() | layers.ConnectPeer():
                return await self._connect(request)
            case _:
                assert_never(request)

    async def _connect(self, request: layers.ConnectProgram | layers.ConnectPeer) -> layers.Event:
        end: pump.End
        peer = None
        if isinstance(request, layers.ConnectPeer):
            end = stream = await self._stream_to(request.remote)
            peer = stream.peer
        else:
            await self._close_program_rpc()
            end = self.program = await self._connect_program(request.local)
        await end.send(tcpros.encode(request.fields))
        answer, self.after_header = await pump.split_header(end)
        return layers.HeaderArrived(answer, peer, clock.now())

    async def _stream_to(self, remote: layers.ListeningAddress) -> SecureStream[Identity]:
        if self.stream is None:
            try:
                self.stream = await self._services.dial(remote)
            except PeerUnreachable as error:
                self._services.note_unreachable(remote, error)
                raise
        return self.stream

    async def _rpc_to_program(self, local: layers.ListeningAddress) -> RpcClient:
        if self._program_rpc is None or self._program_rpc.closed:
            self._program_rpc = RpcClient(
                await self._connect_program(local), host=self._services.callers.loopback.host, compact=False
            )
        return self._program_rpc

    async def _connect_program(self, local: layers.ListeningAddress) -> loopback_port.PlainStream:
        # Checked before and after: between the two the program may have ended, and another have its port.
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
        return loopback_port.PlainStream(sock)

    async def _probe_egress(self, remote: layers.ListeningAddress) -> int:
        # Open a port only if the peer answers; its connection is cached for the next caller.
        try:
            async with asyncio.timeout(DEADLINE):
                client = await self._connect_peer(remote)
                await self._present_grants(client, Right.GRAPH)
        except (RossecError, OSError, TimeoutError):
            return self._no_answer(remote)
        self._services.cache_client(remote, client)
        return self._services.open_egress(remote)

    def _no_answer(self, remote: layers.ListeningAddress) -> int:
        # The port of a peer that does not answer: it refuses callers, as that of a dead node. One behind a
        # forwarded port may be out of reach for a while, and programs that were refused never try again: they
        # are admitted and hung up on.
        services = self._services
        return services.open_egress(remote) if remote.forwarded_port else services.refuse_egress(remote)

    async def _client_of_peer(self, remote: layers.ListeningAddress, right: Right | None) -> SlaveApiClient:
        if self._peer_client is None or not self._peer_client.usable:
            self._peer_client = self._services.cached_client(remote)
        if self._peer_client is None or not self._peer_client.usable:
            self._peer_client = await self._connect_peer(remote)
        self._services.check_peer(self._peer_client.peer)  # connected long ago, perhaps
        if right is not None and right not in self._peer_client.presented:
            await self._present_grants(self._peer_client, right)
        return self._peer_client

    async def _connect_peer(self, remote: layers.ListeningAddress) -> SlaveApiClient:
        try:
            stream = await self._services.dial(remote)
        except PeerUnreachable as error:
            self._services.note_unreachable(remote, error)
            self._no_answer(remote)
            raise
        return SlaveApiClient(RpcClient(stream), stream.peer)

    async def _present_grants(self, client: SlaveApiClient, right: Right) -> None:
        grants = self._services.proof(right, client.peer.name)
        with contextlib.suppress(xmlrpc.Fault):
            await client.rpc.call(names.PRESENT_GRANTS, self._services.name, grants)
        client.presented.add(right)


async def _call(rpc: RpcClient, method: str, params: tuple[object, ...], *, parse: bool) -> layers.Event:
    if parse:
        return layers.Answered(await rpc.call(method, *params))
    return layers.RawResponse(await rpc.fetch(method, *params))


async def run_layer(services: AgentServices, layer: layers.Layer[layers.Outcome]) -> layers.Outcome:
    executor = CommandExecutor(services)
    try:
        return await executor.run(layer)
    finally:
        await executor.close()
