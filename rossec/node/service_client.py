"""Calls of a service: a connection for each call, or a persistent one.

The master provides the address of the provider only. Its identity comes from the channel, its right to
provide from the grant it presents; `ServiceGuard` filters what is sent and received. A connection that failed
during a call is not used again: a late response must not be taken for that of the next call.
"""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Final, Self, TypeAlias

from ca.certificates import Identity
from ca.names import shown
from grants.decision import Decision
from rossec import clock
from rossec.errors import ChannelClosed, ConfigurationError, ServiceFailed
from rossec.host.runner import TaskSet
from rossec.net.aio import SecureStream
from rossec.net.limits import unit_limit
from rossec.node.context import NodeConnection, NodeContext
from rossec.participant import handshakes
from rossec.participant.access import Access
from rossec.participant.authorized import AuthorizedConnection
from rossec.participant.message_types import Message
from rossec.participant.service_types import ServiceGuard, ServiceType
from rossec.ros import tcpros

CALL_DEADLINE: Final = 60.0
HANDSHAKE_DEADLINE: Final = 5.0

ProviderConnection: TypeAlias = NodeConnection[ServiceGuard]
Dial = Callable[[str], Awaitable[SecureStream[Identity]]]  # service -> stream to its provider


async def exchange_headers(
    stream: SecureStream[Identity],
    caller: str,
    service: str,
    kind: handshakes.ExpectedService,
    access: Access,
    *,
    persistent: bool = False,
    probe: bool = False,
) -> tuple[handshakes.Fields, Decision]:
    """Exchange headers with a provider; returns its header, and the decision on its grants."""
    fields = handshakes.client_header(
        caller, service, kind, access, clock.now(), persistent=persistent, probe=probe
    )
    await stream.send(tcpros.encode(fields))
    frames = tcpros.FrameReader(tcpros.HEADER_LIMIT)
    while (arrived := frames.feed_one(await stream.receive())) is None:
        pass
    answer = tcpros.decode(arrived)
    return answer, handshakes.admit_provider(answer, stream.peer, service, access, clock.now())


class ServiceClient:
    """Calls one service: `response = await client(data=True)`. Made by `Node.client`."""

    def __init__(
        self,
        service: str,
        kind: ServiceType,
        context: NodeContext,
        dial: Dial,
        on_close: Callable[["ServiceClient"], None],
        *,
        persistent: bool = False,  # keep the connection between calls, which then run one at a time
        deadline: float = CALL_DEADLINE,  # seconds a call may take, connecting included
    ) -> None:
        if deadline <= 0:
            raise ConfigurationError(f"a deadline of {deadline:g} seconds", "it must be above zero")
        self.service = service
        self.kind = kind
        self.links: set[ProviderConnection] = set()
        self._context = context
        self._dial = dial
        self._on_close = on_close
        self._persistent = persistent
        self._deadline = deadline
        self._cached: ProviderConnection | None = None
        self._turn = asyncio.Lock()
        self._task_set = TaskSet()
        self._closed = False

    def create(self, /, **fields: object) -> Message:
        return self.kind.request.create(**fields)

    async def __call__(self, request: Message | None = None, /, **fields: object) -> Message:
        if request is None:
            request = self.create(**fields)
        response = await self.call_bytes(self.kind.request.serialize(request))
        return self.kind.response.deserialize(response)

    async def call_bytes(self, request: bytes | memoryview) -> bytes:
        if self._closed:
            raise ChannelClosed(f"the client of {shown(self.service)} is closed")
        try:
            async with asyncio.timeout(self._deadline), self._connection() as connection:
                return await self._exchange(connection, request)
        except TimeoutError:
            raise ServiceFailed(f"{shown(self.service)} did not answer in time") from None

    async def close(self) -> None:
        self._closed = True
        for connection in tuple(self.links):
            connection.stream.abort("the client is closed")
            self._context.connections.discard(connection)
        self.links.clear()
        await self._task_set.close()
        self._on_close(self)

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    @contextlib.asynccontextmanager
    async def _connection(self) -> AsyncIterator[ProviderConnection]:
        if not self._persistent:
            connection = await self._connect()
            try:
                yield connection
            finally:
                connection.stream.abort("the call is over")
            return
        async with self._turn:
            if self._cached is None:
                self._cached = await self._connect()
            yield self._cached

    async def _exchange(self, connection: ProviderConnection, request: bytes | memoryview) -> bytes:
        self._context.connections.check(connection)
        allowed = connection.guard.request(request, clock.time())
        complete = False
        try:
            frames = tcpros.response_reader()
            await connection.stream.send(*tcpros.framed(allowed))
            while (content := frames.feed_one(await connection.stream.receive())) is None:
                pass
            response = tcpros.open_response(content)
            complete = True
        except ServiceFailed:
            complete = True
            raise
        finally:
            if not complete:  # a late response would be taken for that of the next call
                self._discard(connection)
        return b"".join(connection.guard.response(response, clock.time()))

    async def _connect(self) -> ProviderConnection:
        stream = await self._dial(self.service)
        try:
            kind = handshakes.ExpectedService(self.kind.name, self.kind.md5sum)
            caller, access = self._context.name_for(stream.peer), self._context.access
            async with asyncio.timeout(HANDSHAKE_DEADLINE):
                answer, decision = await exchange_headers(
                    stream, caller, self.service, kind, access, persistent=self._persistent
                )
            handshakes.check_md5(answer, self.service, kind.md5sum)
            stream.raise_unit_limit(unit_limit(self.kind.response_layout.root.size, tcpros.MESSAGE_LIMIT))
            connection = AuthorizedConnection(stream, decision, self._guard(decision), self._guard)
            # In the table before the first request: from here on a revocation cuts it.
            self._context.connections.add(connection)
        except BaseException:
            stream.abort("the connection header was refused")
            raise
        self.links.add(connection)

        async def discard_when_ended() -> None:  # so that the next call does not use it
            await connection.stream.wait_ended()
            self._discard(connection)

        self._task_set.spawn(discard_when_ended(), f"{self.service}: connection")
        return connection

    def _guard(self, decision: Decision) -> ServiceGuard:
        context = self._context
        return ServiceGuard(self.kind, decision, context.filter_key, context.memory_scope)

    def _discard(self, connection: ProviderConnection) -> None:
        connection.stream.abort("the call failed before its end")
        self._context.connections.discard(connection)
        self.links.discard(connection)
        if self._cached is connection:
            self._cached = None
