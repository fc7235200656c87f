"""A service this node provides: its callers, and what each of them may send and receive.

Every request is checked again, as a connection may be hours old. The requests of one connection are
answered one after the other; a caller that sends faster is not read from. Exceptions of a handler
are not sent to the caller, except `ServiceFailed`.
"""

import asyncio
import inspect
import logging
from collections.abc import Awaitable, Callable, Mapping
from typing import Any, Final, TypeAlias
from weakref import WeakValueDictionary

from ca.certificates import Identity
from ca.domains.aliases import shown
from grants.decision import Decision
from grants.errors import GrantError
from rossec import clock
from rossec.errors import (
    ConfigurationError,
    FrameRefused,
    MessageError,
    RossecError,
    ServiceFailed,
    ServiceRefused,
)
from rossec.net import withheld_log
from rossec.net.aio import SecureStream
from rossec.node.context import NodeConnection, NodeContext
from rossec.participant.authorized import AuthorizedConnection
from rossec.participant.message_types import Message, field_names
from rossec.participant.service_guard import Pieces, ServiceGuard
from rossec.participant.service_handshake import ExpectedService
from rossec.participant.service_types import ServiceType
from rossec.ros import service as wire

REQUEST_DEADLINE: Final = 10.0  # seconds from the beginning of a request to its end
HANDLER_DEADLINE: Final = 60.0
CONCURRENCY: Final = 8

CallerConnection: TypeAlias = NodeConnection[ServiceGuard]
Response: TypeAlias = "Message | Mapping[str, object] | Awaitable[Any] | None"
Handler = Callable[[Any], Response]
CallerHandler = Callable[[Any, Identity], Response]
_log = logging.getLogger("rossec.node")


async def receive_request(stream: SecureStream[Identity], *, wait: bool) -> bytes:
    """The next request; `wait` without a time limit for it to begin.

    Raises:
        FrameRefused: it is too long, did not arrive in time, or more follows it.
        ChannelError: the connection was closed.
    """
    frames = wire.request_reader()
    content = frames.feed_one(await stream.receive()) if wait else None
    try:
        async with asyncio.timeout(REQUEST_DEADLINE):
            while content is None:
                content = frames.feed_one(await stream.receive())
    except TimeoutError:
        raise FrameRefused("a request that did not arrive in time") from None
    return content


class Service:
    """Answers calls of one service. Made by `Node.service`.

    Args:
        handler: takes a request and the identity of its caller, returns the response: a message,
            a mapping of its fields, or None if it has none; it may be a coroutine function. A
            plain function blocks the whole node while it runs.
        concurrency: how many calls are handled at a time, half of them of one caller; more wait.
        deadline: seconds a call may take, waiting included.
    """

    def __init__(
        self,
        name: str,
        kind: ServiceType,
        handler: CallerHandler,
        context: NodeContext,
        on_close: Callable[["Service"], Awaitable[None]],
        *,
        concurrency: int = CONCURRENCY,
        deadline: float = HANDLER_DEADLINE,
    ) -> None:
        if concurrency < 1 or deadline <= 0:
            raise ConfigurationError(
                f"{name}: concurrency {concurrency}, deadline {deadline:g} s",
                "both must be above zero",
            )
        self.name = name
        self.kind = kind
        self.links: set[CallerConnection] = set()
        self._handler = handler
        self._context = context
        self._on_close = on_close
        self._slots = asyncio.Semaphore(concurrency)
        self._share = max(1, concurrency // 2)
        self._shares: WeakValueDictionary[bytes, asyncio.Semaphore] = WeakValueDictionary()
        self._deadline = deadline

    @property
    def expected(self) -> ExpectedService:
        """Type and md5sum, as in connection headers."""
        return ExpectedService(self.kind.name, self.kind.md5sum)

    def create(self, /, **fields: object) -> Message:
        """A zero response with `fields` set."""
        return self.kind.response.create(**fields)

    async def close(self) -> None:
        """Unregister and close the connection of every caller."""
        for connection in tuple(self.links):
            connection.stream.abort("the service is closed")
        await self._on_close(self)

    def guard(self, decision: Decision) -> ServiceGuard:
        """The guard that applies `decision` to the messages; raises as `ServiceGuard`."""
        return ServiceGuard(
            self.kind, decision, self._context.filter_key, self._context.memory_scope
        )

    async def serve(
        self,
        stream: SecureStream[Identity],
        decision: Decision,
        guard: ServiceGuard,
        answer: bytes,
        *,
        persistent: bool,
    ) -> None:
        """Answer one admitted caller: its header, then its calls, until its stream ends.

        It is registered before the answer is sent: a revocation received meanwhile closes it.
        """
        connection = AuthorizedConnection(stream, decision, guard, self.guard)
        share = self._share_of(stream.peer)
        self.links.add(connection)
        try:
            with self._context.connections.track(connection):
                await stream.send(answer)
                await self._answer(
                    connection, share, await receive_request(stream, wait=persistent)
                )
                while persistent:
                    await self._answer(connection, share, await receive_request(stream, wait=True))
        except RossecError as error:
            _log.info("%s: %s left: %s", self.name, shown(stream.peer.name), error)
        finally:
            self.links.discard(connection)

    def _share_of(self, caller: Identity) -> asyncio.Semaphore:
        """The calls of one caller at a time: at most half, on however many connections."""
        share = self._shares.get(caller.thumbprint)
        if share is None:
            share = self._shares[caller.thumbprint] = asyncio.Semaphore(self._share)
        return share

    async def _answer(
        self, connection: CallerConnection, share: asyncio.Semaphore, request: bytes
    ) -> None:
        self._context.connections.check(connection)
        await connection.stream.send(*await self._respond(connection, share, request))

    async def _respond(
        self, connection: CallerConnection, share: asyncio.Semaphore, request: bytes
    ) -> Pieces:
        """The response, or the error response, as bytes."""
        try:
            async with asyncio.timeout(self._deadline), share, self._slots:
                allowed = b"".join(connection.guard.request(request, clock.time()))
                data = await self._handle(self._parse(allowed), connection.stream.peer)
                return wire.success(connection.guard.response(data, clock.time()))
        except ServiceFailed as error:
            return wire.failure(str(error))
        except (ServiceRefused, GrantError) as error:
            withheld_log.warn(
                _log, withheld_log.REFUSED, self.name, shown(connection.stream.peer.name), error
            )
            return wire.failure(f"rossec: {error}")
        except TimeoutError:
            took = f"a call took more than {self._deadline:g} s"
            withheld_log.warn(
                _log, withheld_log.REFUSED, self.name, shown(connection.stream.peer.name), took
            )
            return wire.failure("the service took too long")

    def _parse(self, request: bytes) -> Message:
        try:
            return self.kind.request.deserialize(request)
        except MessageError as error:
            raise ServiceRefused(f"not one {self.kind.request.name}") from error

    async def _handle(self, request: Message, caller: Identity) -> memoryview:
        """The serialized response; the caller is sent no exception but `ServiceFailed`."""
        try:
            result = self._handler(request, caller)
            if inspect.isawaitable(result):
                result = await result
            return self.kind.response.serialize(self._response(result))
        except ServiceFailed:
            raise
        except Exception as error:
            _log.exception("%s: the handler failed", self.name)
            raise ServiceFailed("the service failed") from error

    def _response(self, result: object) -> Message:
        if isinstance(result, Mapping):
            return self.create(**result)
        empty = self.create()
        if result is None and not field_names(empty):
            return empty
        if type(result) is not type(empty):
            raise MessageError(
                f"the handler of {self.name} did not return a {self.kind.response.name}",
                "return service.create(...), or a mapping of its fields",
            )
        return result
