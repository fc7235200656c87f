"""The services of one node: those it provides, those it calls, and their registrations.

A caller is authorized before this node looks up the service: a caller or a probe without the right
learns nothing (attack N6).
"""

import asyncio
import contextlib
from collections.abc import Awaitable, Callable, Mapping
from functools import partial
from typing import Final

from ca.certificates import Identity
from ca.domains.aliases import shown
from ca.errors import HintedError, RevocationsStale
from rossec import clock
from rossec.errors import (
    AnswerMalformed,
    AnswerRefused,
    ChannelError,
    ConfigurationError,
    ConnectionHeaderRefused,
    ServiceUnavailable,
)
from rossec.net.aio import SecureStream
from rossec.net.bounds import unit_limit
from rossec.node.context import NodeContext
from rossec.node.service import CONCURRENCY, HANDLER_DEADLINE, CallerHandler, Service
from rossec.node.service_client import CALL_DEADLINE, ServiceClient, probe
from rossec.participant.header_fields import Fields
from rossec.participant.remote_names import refuse_offer
from rossec.participant.service_handshake import (
    admit_caller,
    check_md5,
    is_set,
    requested_service,
    server_header,
)
from rossec.participant.service_types import ServiceType
from rossec.ros import header
from rossec.ros.service import REQUEST_LIMIT

_POLL_PERIOD: Final = 0.3  # seconds between probes of a service, as in rospy
_PASSING: Final = (ServiceUnavailable, ChannelError, OSError, TimeoutError, RevocationsStale)
_ABSENT: Final = "no provider"  # status of the master, as stock; a refusal begins with "rossec: "


class Services:
    """The provided services by name, and the clients."""

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
        """Register the service `name`, a full name; `handler(request, caller)`; see `Service`.

        Raises:
            RossecError: a second provider in this node, a name below /remote, or the master
                refuses.
        """
        refuse_offer(name, "provided")
        if name in self._provided:
            raise ConfigurationError(f"{name} is provided by this node already")
        service = Service(
            name, kind, handler, self._context, self._unregister,
            concurrency=concurrency, deadline=deadline,
        )  # fmt: skip
        self._provided[name] = service
        try:
            await self._register(service)
        except BaseException:
            del self._provided[name]
            raise
        return service

    def client(
        self,
        name: str,
        kind: ServiceType,
        *,
        persistent: bool = False,
        deadline: float = CALL_DEADLINE,
    ) -> ServiceClient:
        """A client of the service `name`; nothing is connected yet."""
        client = ServiceClient(
            name, kind, self._context, self.dial, self._clients.discard,
            persistent=persistent, deadline=deadline,
        )  # fmt: skip
        self._clients.add(client)
        return client

    async def wait_for(self, name: str, within: float | None = None) -> None:
        """Return as soon as a provider of `name` answers.

        Raises:
            ServiceUnavailable: none did within so many seconds.
            HintedError: this node may not call it, or the provider may not provide it.
        """
        try:
            async with asyncio.timeout(within):
                await self._wait_for_probe(name)
        except TimeoutError:
            raise ServiceUnavailable(
                f"no node provided {shown(name)} within {within:g} s", "is its provider running?"
            ) from None

    async def _wait_for_probe(self, name: str) -> None:
        while True:
            with contextlib.suppress(*_PASSING):
                await self.probe(name)
                return
            await asyncio.sleep(_POLL_PERIOD)

    async def probe(self, name: str) -> tuple[Fields, Identity]:
        """The header and identity of the provider of `name`; raises as `service_client.probe`."""
        return await probe(self.dial, self._context.name_for, name, self._context.access)

    async def known(self) -> dict[str, list[str]]:
        """Services this node may see, each with its providers.

        Raises:
            RossecError: the master is out of reach, or sends a malformed answer.
        """
        match await self._context.call("getSystemState"):
            case [_, _, [*services]]:
                return dict(_provided(item) for item in services)
            case _:
                raise AnswerMalformed("an invalid system state")

    async def lookup(self, name: str) -> str:
        """The rosrpc URI of the provider of `name`.

        Raises:
            ServiceUnavailable: there is none.
            RossecError: the master refuses, or is out of reach.
        """
        try:
            uri = await self._context.call("lookupService", name)
        except AnswerRefused as error:
            if str(error) != _ABSENT:
                raise
            raise ServiceUnavailable(
                f"no node provides {shown(name)}", "start its provider, or wait for the service"
            ) from error
        return str(uri)

    async def dial(self, name: str) -> SecureStream[Identity]:
        """Connect to the provider of `name`; raises as `lookup` and `Dialer.service`."""
        return await self._context.dialer.service(await self.lookup(name))

    def admit(
        self, fields: Mapping[str, bytes], stream: SecureStream[Identity]
    ) -> Callable[[], Awaitable[None]]:
        """Decide on a caller from its header; returns what serves it.

        Raises:
            HintedError: the caller is refused.
        """
        context, now = self._context, clock.now()
        decision = admit_caller(fields, stream.peer, context.access, now)
        name = requested_service(fields)
        service = self._provided.get(name)
        if service is None:
            raise ConnectionHeaderRefused(f"{context.name} does not provide {name}")
        check_md5(fields, name, service.kind.md5sum)
        answer = header.encode(
            server_header(
                context.name_for(stream.peer), name, service.expected, context.access, now
            )
        )
        if is_set(fields, "probe"):
            return partial(stream.send, answer)
        guard = service.guard(decision)
        stream.raise_unit_limit(unit_limit(service.kind.request_layout.root.size, REQUEST_LIMIT))
        persistent = is_set(fields, "persistent")
        return partial(service.serve, stream, decision, guard, answer, persistent=persistent)

    async def withdraw(self, name: str) -> None:
        """End a service of this node, if it is provided."""
        service = self._provided.get(name)
        if service is not None:
            await service.close()

    async def restore(self) -> None:
        """Register everything again: the master was restarted, or there is a new grant."""
        for service in tuple(self._provided.values()):
            with self._context.restoring(service.name):
                await self._register(service)

    async def close(self) -> None:
        """Close every client and every service; unregister."""
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
            raise AnswerMalformed("an invalid system state")
