"""What one connection keeps open at its other end, and how commands are carried out for it.

A shell: it dials, asks and reports; it decides nothing. Whoever answers outside is checked before
anything is said to it, and whoever listens inside before it is connected to.
"""

import asyncio
import contextlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, Protocol, assert_never

from ca.certificates import Identity
from ca.errors import HintedError
from grants.model import Right
from rossec import clock
from rossec.errors import PeerUnreachable, RossecError
from rossec.net.aio.dial import dial
from rossec.net.aio.stream import SecureStream
from rossec.net.rpc.client import RpcClient
from rossec.participant.slave_rights import PRESENT
from rossec.ros import header, xmlrpc
from rossec.ros.xmlrpc import Fault
from rossec.sidecar.callers import Callers
from rossec.sidecar.core.commands import (
    AskLocal,
    AskMaster,
    AskRemote,
    Command,
    ConnectPeer,
    ConnectProgram,
    OpenEgress,
    OpenIngress,
    Probe,
    Question,
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
    Passed,
)
from rossec.sidecar.core.layers import Layer, Outcome
from rossec.sidecar.plain_stream import PlainStream
from rossec.sidecar.pump import split_header

DEADLINE: Final = 10.0


@dataclass
class SlaveApiClient:
    """A peer's slave API, connected; `shown` are the rights whose grants it has seen."""

    client: RpcClient
    peer: Identity
    shown: set[Right] = field(default_factory=set)

    @property
    def usable(self) -> bool:
        """Whether it can still be asked."""
        return not self.client.closed


class AgentServices(Protocol):
    """What a visit needs of the identity it is made for."""

    @property
    def name(self) -> str:
        """Its certified name."""

    @property
    def callers(self) -> Callers:
        """Which programs may be reached."""

    def export(self, local: Endpoint) -> int:
        """The port outside for `local`."""

    def rest(self, local: Endpoint) -> None:
        """Refuse callers for `local`."""

    def bring(self, remote: Endpoint) -> int:
        """The loopback port for `remote`; it listens."""

    def shut(self, remote: Endpoint) -> int:
        """The loopback port for `remote`; it refuses callers."""

    def keep(self, remote: Endpoint, correspondent: SlaveApiClient) -> None:
        """Keep a connection for the next caller of `remote`."""

    def kept(self, remote: Endpoint) -> SlaveApiClient | None:
        """Such a connection, for this caller alone."""

    async def dial(self, remote: Endpoint) -> SecureStream[Identity]:
        """Connect to a peer whose identity holds."""

    def check(self, peer: Identity) -> None:
        """Return if the identity of `peer` holds still. Raises a `HintedError`."""

    async def ask_master(self, method: str, params: tuple[object, ...]) -> object:
        """The master's answer."""

    def proof(self, right: Right, name: str) -> bytes:
        """Grants that prove `right` on `name`."""


class CommandExecutor:
    """One connection's other end.

    Attributes:
        program, stream: the end that was met for TCPROS.
        first: what it sent after its header.
    """

    def __init__(self, house: AgentServices) -> None:
        self._house = house
        self._client: RpcClient | None = None
        self._remote: SlaveApiClient | None = None
        self.program: PlainStream | None = None
        self.stream: SecureStream[Identity] | None = None
        self.first = b""

    async def run(self, layer: Layer[Outcome]) -> Outcome:
        """Run a layer to its end."""
        try:
            command = next(layer)
            while True:
                try:
                    event = await self._carry_out(command)
                except Fault as fault:  # an answer as well; multicalls give it to one element
                    command = layer.throw(fault)
                else:
                    command = layer.send(event)
        except StopIteration as done:
            outcome: Outcome = done.value
            return outcome

    async def close(self) -> None:
        """Drop what is open."""
        await self._leave()
        if self._remote is not None:
            with contextlib.suppress(RossecError, OSError):
                await self._remote.client.close()
        if self.program is not None:
            self.program.abort()
        if self.stream is not None:
            self.stream.abort("the other end is gone")

    async def _leave(self) -> None:
        """Close the connection to a program's slave API; what follows may last for days."""
        client, self._client = self._client, None
        if client is not None:
            with contextlib.suppress(RossecError, OSError):
                await client.close()

    async def _carry_out(self, command: Command) -> Event:
        match command:
            case OpenIngress(local):
                return Opened(self._house.export(local))
            case OpenEgress(remote, probe):
                return Opened(await self._bring(remote) if probe else self._house.bring(remote))
            case Suspend(local):
                self._house.rest(local)
                return CommandDone()
            case _:
                return await self._ask(command)

    async def _ask(self, question: Question) -> Event:
        try:
            async with asyncio.timeout(DEADLINE):
                return await self._answer(question)
        except ConnectionRefusedError as error:
            return NoAnswer(str(error), dead=True)
        except (HintedError, OSError, TimeoutError) as error:
            return NoAnswer(str(error) or "no answer in time")

    async def _answer(self, question: Question) -> Event:
        match question:
            case AskMaster(method, params):
                return Answered(await self._house.ask_master(method, params))
            case AskLocal(local, method, params, parse):
                return await _call(await self._inside(local), method, params, parse=parse)
            case AskRemote(remote, method, params, right, parse):
                client = await self._outside(remote, right)
                return await _call(client, method, params, parse=parse)
            case Probe(local):
                await self._inside(local)
                return CommandDone()
            case ConnectProgram(local, fields):
                await self._leave()
                self.program = await self._connect(local)
                return await self._meet(self.program, None, fields)
            case ConnectPeer(remote, fields):
                self.stream = await self._house.dial(remote)
                return await self._meet(self.stream, self.stream.peer, fields)
            case _:
                assert_never(question)

    async def _meet(
        self,
        end: PlainStream | SecureStream[Identity],
        peer: Identity | None,
        fields: Mapping[str, bytes],
    ) -> Event:
        await end.send(header.encode(fields))
        answer, self.first = await split_header(end)
        return HeaderArrived(answer, peer, clock.now())

    async def _inside(self, local: Endpoint) -> RpcClient:
        if self._client is None or self._client.closed:
            self._client = RpcClient(
                await self._connect(local), host=self._house.callers.loopback.host
            )
        return self._client

    async def _connect(self, local: Endpoint) -> PlainStream:
        callers = self._house.callers
        holders = await callers.check_listener(local.port)
        sock = await dial(callers.loopback.address, local.port, DEADLINE)
        try:
            callers.check_unchanged(local.port, holders)
        except BaseException:
            sock.close()
            raise
        return PlainStream(sock)

    async def _bring(self, remote: Endpoint) -> int:
        """A door that opens only if the peer answers; its connection is kept for who comes next."""
        try:
            async with asyncio.timeout(DEADLINE):
                correspondent = await self._reach(remote)
                await self._show(correspondent, Right.GRAPH)
        except (RossecError, OSError, TimeoutError):
            return self._house.shut(remote)
        self._house.keep(remote, correspondent)
        return self._house.bring(remote)

    async def _outside(self, remote: Endpoint, right: Right | None) -> RpcClient:
        if self._remote is None or not self._remote.usable:
            self._remote = self._house.kept(remote)
        if self._remote is None or not self._remote.usable:
            self._remote = await self._reach(remote)
        self._house.check(self._remote.peer)  # it may have been met long ago
        if right is not None and right not in self._remote.shown:
            await self._show(self._remote, right)
        return self._remote.client

    async def _reach(self, remote: Endpoint) -> SlaveApiClient:
        try:
            stream = await self._house.dial(remote)
        except PeerUnreachable:
            self._house.shut(remote)
            raise
        return SlaveApiClient(RpcClient(stream), stream.peer)

    async def _show(self, correspondent: SlaveApiClient, right: Right) -> None:
        """Show grants; whether they suffice is heard with the answer to the question itself."""
        grants = self._house.proof(right, correspondent.peer.name)
        with contextlib.suppress(Fault):
            await correspondent.client.call(PRESENT, self._house.name, grants)
        correspondent.shown.add(right)


async def _call(
    client: RpcClient, method: str, params: tuple[object, ...], *, parse: bool
) -> Event:
    body = await client.fetch(method, *params)
    return Answered(xmlrpc.load_response(body)) if parse else Passed(body)
