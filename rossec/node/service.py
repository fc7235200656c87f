"""The services of one node: those it provides, what each caller may send and receive, and their
registrations.

A caller is authorized before this node looks up the service: a caller or a probe without the right learns
nothing (attack N6). Every request is checked again, as a connection may be hours old. The requests of one
connection are answered one after the other; a caller that sends faster is not read from. Exceptions of a
handler are not sent to the caller, except `ServiceFailed`.
"""

import asyncio
import contextlib
import inspect
import logging
from collections.abc import Awaitable, Callable, Mapping
from functools import partial
from typing import Any, Final, TypeAlias
from weakref import WeakValueDictionary

from ca.certificates import Identity
from ca.errors import HintedError, RevocationsStale
from ca.names import shown
from grants.decision import Decision
from grants.errors import GrantError
from rossec import clock, errors
from rossec.net.aio import SecureStream
from rossec.net.limits import unit_limit
from rossec.node.context import NodeConnection, NodeContext
from rossec.node.service_client import CALL_DEADLINE, HANDSHAKE_DEADLINE, ServiceClient, exchange_headers
from rossec.participant import delivery_options, handshakes
from rossec.participant.authorized import AuthorizedConnection
from rossec.participant.message_types import Message, field_names
from rossec.participant.service_types import Pieces, ServiceGuard, ServiceType
from rossec.ros import tcpros

REQUEST_DEADLINE: Final = 10.0  # seconds from the beginning of a request to its end
HANDLER_DEADLINE: Final = 60.0
CONCURRENCY: Final = 8
_POLL_PERIOD: Final = 0.3  # seconds between probes of a service, as in rospy
_PASSING: Final = (errors.ServiceUnavailable, errors.ChannelError, OSError, TimeoutError, RevocationsStale)
_ABSENT: Final = "no provider"  # status of the master, as stock; a refusal begins with "rossec: "

CallerConnection: TypeAlias = NodeConnection[ServiceGuard]
Response: TypeAlias = "Message | Mapping[str, object] | Awaitable[Any] | None"
Handler = Callable[[Any], Response]
CallerHandler = Callable[[Any, Identity], Response]
_log = logging.getLogger("rossec.node")


async def receive_request(stream: SecureStream[Identity], *, wait: bool) -> bytes:
    """The next request; `wait` without a time limit for it to begin."""
    frames = tcpros.request_reader()
    content = frames.feed_one(await stream.receive()) if wait else None
    try:
        async with asyncio.timeout(REQUEST_DEADLINE):
            while content is None:
                content = frames.feed_one(await stream.receive())
    except TimeoutError:
        raise errors.WireError("a request that did not arrive in time") from None
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
            raise errors.ConfigurationError(
                f"{name}: concurrency {concurrency}, deadline {deadline:g} s", "both must be above zero"
            )
        self.name = name
        self.kind = kind
        self.links: set[CallerConnection] = set()
        self._handler = handler
        self._context = context
        self._on_close = on_close
        self._slots = asyncio.Semaphore(concurrency)
        # Half for one caller: others still find a slot (attack `service-occupied`).
        self._share = max(1, concurrency // 2)
        # Weak: a caller without a connection needs no entry.
        self._shares: WeakValueDictionary[bytes, asyncio.Semaphore] = WeakValueDictionary()
        self._deadline = deadline

    @property
    def expected(self) -> handshakes.ExpectedService:
        return handshakes.ExpectedService(self.kind.name, self.kind.md5sum)

    def create(self, /, **fields: object) -> Message:
        return self.kind.response.create(**fields)

    async def close(self) -> None:
        for connection in tuple(self.links):
            connection.stream.abort("the service is closed")
        await self._on_close(self)

    def guard(self, decision: Decision) -> ServiceGuard:
        return ServiceGuard(self.kind, decision, self._context.filter_key, self._context.memory_scope)

    async def serve(
        self,
        stream: SecureStream[Identity],
        decision: Decision,
        guard: ServiceGuard,
        answer: bytes,
        *,
        persistent: bool,
    ) -> None:
        # It is registered before the answer is sent: a revocation received meanwhile closes it.
        connection = AuthorizedConnection(stream, decision, guard, self.guard)
        share = self._shares.get(stream.peer.thumbprint)
        if share is None:
            share = self._shares[stream.peer.thumbprint] = asyncio.Semaphore(self._share)
        self.links.add(connection)
        try:
            with self._context.connections.track(connection):
                await stream.send(answer)
                await self._answer(connection, share, await receive_request(stream, wait=persistent))
                while persistent:
                    await self._answer(connection, share, await receive_request(stream, wait=True))
        except errors.RossecError as error:
            _log.info("%s: %s left: %s", self.name, shown(stream.peer.name), error)
        finally:
            self.links.discard(connection)

    async def _answer(self, connection: CallerConnection, share: asyncio.Semaphore, request: bytes) -> None:
        self._context.connections.check(connection)  # at each request: the connection may be hours old
        await connection.stream.send(*await self._respond(connection, share, request))

    async def _respond(
        self, connection: CallerConnection, share: asyncio.Semaphore, request: bytes
    ) -> Pieces:
        try:
            async with asyncio.timeout(self._deadline), share, self._slots:
                allowed = b"".join(connection.guard.request(request, clock.time()))
                try:
                    parsed = self.kind.request.deserialize(allowed)
                except errors.MessageError as error:
                    raise errors.ServiceRefused(f"not one {self.kind.request.name}") from error
                data = await self._handle(parsed, connection.stream.peer)
                return tcpros.success(connection.guard.response(data, clock.time()))
        except errors.ServiceFailed as error:
            return tcpros.failure(str(error))
        except (errors.ServiceRefused, GrantError) as error:
            delivery_options.warn(
                _log, delivery_options.REFUSED, self.name, shown(connection.stream.peer.name), error
            )
            return tcpros.failure(f"rossec: {error}")
        except TimeoutError:
            took = f"a call took more than {self._deadline:g} s"
            delivery_options.warn(
                _log, delivery_options.REFUSED, self.name, shown(connection.stream.peer.name), took
            )
            return tcpros.failure("the service took too long")

    async def _handle(self, request: Message, caller: Identity) -> memoryview:
        try:
            result = self._handler(request, caller)
            if inspect.isawaitable(result):
                result = await result
            return self.kind.response.serialize(self._response(result))
        except errors.ServiceFailed:
            raise
        except Exception as error:
            # The text of an exception may hold what the caller may not read: it is for this log alone.
            _log.exception("%s: the handler failed", self.name)
            raise errors.ServiceFailed("the service failed") from error

    def _response(self, result: object) -> Message:
        if isinstance(result, Mapping):
            return self.create(**result)
        empty = self.create()
        if result is None and not field_names(empty):
            return empty
        if type(result) is not type(empty):
            raise errors.MessageError(
                f"the handler of {self.name} did not return a {self.kind.response.name}",
                "return service.create(...), or a mapping of its fields",
            )
        return result


class Services:
    def __init__(self, context: NodeContext) -> None:
        self._context = context
        self._provided: dict[str, Service] = {}
        self._clients: set[ServiceClient] = set()

    async def provide(
        self,
        name: str,
        kind: ServiceType,
        handler: CallerHandler,
        *,
        concurrency: int = CONCURRENCY,
        deadline: float = HANDLER_DEADLINE,
    ) -> Service:
        """Register the service `name`, a full name; `handler(request, caller)`; see `Service`."""
        handshakes.refuse_offer(name, "provided")
        if name in self._provided:
            raise errors.ConfigurationError(f"{name} is provided by this node already")
        service = Service(
            name, kind, handler, self._context, self._unregister, concurrency=concurrency, deadline=deadline
        )
        self._provided[name] = service
        try:
            await self._register(service)
        except BaseException:
            del self._provided[name]
            raise
        return service

    def client(
        self, name: str, kind: ServiceType, *, persistent: bool = False, deadline: float = CALL_DEADLINE
    ) -> ServiceClient:
        """A client of the service `name`; nothing is connected yet."""
        client = ServiceClient(
            name,
            kind,
            self._context,
            self.dial,
            self._clients.discard,
            persistent=persistent,
            deadline=deadline,
        )
        self._clients.add(client)
        return client

    async def wait_for(self, name: str, within: float | None = None) -> None:
        """Return as soon as a provider of `name` answers."""
        try:
            async with asyncio.timeout(within):
                while True:
                    with contextlib.suppress(*_PASSING):
                        await self.probe(name)
                        return
                    await asyncio.sleep(_POLL_PERIOD)
        except TimeoutError:
            raise errors.ServiceUnavailable(
                f"no node provided {shown(name)} within {within:g} s", "is its provider running?"
            ) from None

    async def probe(self, name: str) -> tuple[handshakes.Fields, Identity]:
        """Request the header of the provider of `name`; returns it and the provider's identity."""
        async with asyncio.timeout(HANDSHAKE_DEADLINE):
            stream = await self.dial(name)
            try:
                caller, access = self._context.name_for(stream.peer), self._context.access
                answer, _ = await exchange_headers(stream, caller, name, handshakes.ANY, access, probe=True)
            finally:
                stream.abort("only a probe")
        return answer, stream.peer

    async def known(self) -> dict[str, list[str]]:
        """Services this node may see, each with its providers."""
        match await self._context.call("getSystemState"):
            case [_, _, [*services]]:
                return dict(_provided(item) for item in services)
            case _:
                raise errors.AnswerMalformed("an invalid system state")

    async def lookup(self, name: str) -> str:
        """The rosrpc URI of the provider of `name`."""
        try:
            uri = await self._context.call("lookupService", name)
        except errors.AnswerRefused as error:
            if str(error) != _ABSENT:
                raise
            raise errors.ServiceUnavailable(
                f"no node provides {shown(name)}", "start its provider, or wait for the service"
            ) from error
        return str(uri)

    async def dial(self, name: str) -> SecureStream[Identity]:
        return await self._context.dialer.service(await self.lookup(name))

    def admit(
        self, fields: Mapping[str, bytes], stream: SecureStream[Identity]
    ) -> Callable[[], Awaitable[None]]:
        """Decide on a caller from its header; returns what serves it."""
        context, now = self._context, clock.now()
        # The right before the look-up: a probe without it learns nothing (N6).
        decision = handshakes.admit_caller(fields, stream.peer, context.access, now)
        name = handshakes.requested_service(fields)
        service = self._provided.get(name)
        if service is None:
            raise errors.ConnectionHeaderRefused(f"{context.name} does not provide {name}")
        handshakes.check_md5(fields, name, service.kind.md5sum)
        caller = context.name_for(stream.peer)
        answer = tcpros.encode(handshakes.server_header(caller, name, service.expected, context.access, now))
        if handshakes.is_set(fields, "probe"):
            return partial(stream.send, answer)
        guard = service.guard(decision)
        # Only now: of a peer without the right no more than a header is kept (N8).
        stream.raise_unit_limit(unit_limit(service.kind.request_layout.root.size, tcpros.REQUEST_LIMIT))
        persistent = handshakes.is_set(fields, "persistent")
        return partial(service.serve, stream, decision, guard, answer, persistent=persistent)

    async def withdraw(self, name: str) -> None:
        service = self._provided.get(name)
        if service is not None:
            await service.close()

    async def restore(self) -> None:
        """Register everything again: the master was restarted, or there is a new grant."""
        for service in tuple(self._provided.values()):
            with self._context.restoring(service.name):
                await self._register(service)

    async def close(self) -> None:
        for client in tuple(self._clients):
            await client.close()
        for service in tuple(self._provided.values()):
            await service.close()

    async def _register(self, service: Service) -> None:
        context = self._context
        await context.call("registerService", service.name, context.rosrpc, context.uri)

    async def _unregister(self, service: Service) -> None:
        if self._provided.get(service.name) is service:
            del self._provided[service.name]
            with contextlib.suppress(HintedError, OSError, TimeoutError):
                await self._context.call("unregisterService", service.name, self._context.rosrpc)


def _provided(item: object) -> tuple[str, list[str]]:
    match item:
        case [str() as name, [*nodes]]:
            return name, [node for node in nodes if isinstance(node, str)]
        case _:
            raise errors.AnswerMalformed("an invalid system state")
