"""One thing and its ROS node: resources become publishers, subscriptions and services.

A notification is published, a message is written by PUT (the newest, when the thing is slower), a
call is a POST. Rights, filters and conditions are those of the node, as for every other node. What
a thing sends that is no message of its type is dropped and counted.
"""

import asyncio
import logging
from collections.abc import Callable
from functools import partial
from typing import Any, Final, Protocol

from aiocoap.numbers import codes

from ca.certificates import Identity
from ca.errors import HintedError
from grants.filters.layout import Layout
from rossec.border.bodies import from_ros, to_ros
from rossec.border.links import PUBLISHER, SERVICE, SUBSCRIBER, Resource
from rossec.border.quotas import MESSAGE_RATE
from rossec.border.requests import Answer, OnAnswer, Request
from rossec.border.thing_node import ThingNode
from rossec.errors import BodyRefused, ServiceFailed, ThingUnreachable
from rossec.net.aio.tasks import TaskSet
from rossec.node.publisher import Publisher
from rossec.node.subscriber import Subscriber
from rossec.participant.message_types import Message
from rossec.participant.service_types import ServiceType, service_type
from rossec.ros.xmlrpc import Fault

CALL_DEADLINE: Final = 30.0
_log = logging.getLogger("rossec.border")

Cancel = Callable[[], None]


class Ask(Protocol):
    """Asks the thing."""

    def __call__(self, request: Request, on_answer: OnAnswer) -> Cancel | None:
        """Send a request; returns what cancels it. None: the thing is not there."""


class ThingBridge:
    """One thing.

    Args:
        node: its ROS node.
        ask: asks the thing.
        tasks: of all things.

    Attributes:
        received, refused: messages of the thing that were published, and that were dropped.
        resources: what it has, as it said last.
    """

    __slots__ = (
        "_ask", "_lock", "_offered", "_running", "_seen", "_tasks", "credential", "node",
        "received", "refused", "resources",
    )  # fmt: skip

    def __init__(self, node: ThingNode, credential: bytes, ask: Ask, tasks: TaskSet) -> None:
        self.node: Final = node
        self.credential: Final = credential
        self._ask = ask
        self._tasks = tasks
        self._lock = asyncio.Lock()  # offering and closing take turns
        self._offered: dict[Resource, Publisher | Subscriber | None] = {}
        self._running: dict[Resource, Cancel] = {}
        self._seen: set[Resource] = set()
        self.resources: tuple[Resource, ...] = ()
        self.received = self.refused = 0

    @property
    def offered(self) -> int:
        """How many of its resources are offered in ROS."""
        return len(self._offered)

    async def follow(self, resources: list[Resource]) -> None:
        """Offer exactly `resources`; one that the master refuses is offered again later."""
        async with self._lock:
            await self._follow(resources)

    async def _follow(self, resources: list[Resource]) -> None:
        gone = self._offered.keys() - set(resources)
        for resource in gone:
            await self._withdraw(resource)
        self.resources = tuple(resources)
        for resource in resources:
            if resource not in self._offered and not self.node.closed:
                await self._offer(resource)
        self.observe()

    def observe(self) -> None:
        """Observe what is published, unless notifications came since the last time."""
        for resource, publisher in self._offered.items():
            if isinstance(publisher, Publisher) and resource not in self._seen:
                self._cancel(resource)
                running = self._ask(
                    Request(codes.GET, resource.path, observe=True),
                    partial(self._notified, resource, publisher),
                )
                if running is not None:
                    self._running[resource] = running
        self._seen.clear()

    def lost(self) -> None:
        """The conversation is over: nothing is observed any more."""
        self._running.clear()
        self._seen.clear()

    async def update(self) -> None:
        """Visit the master, and offer again what was refused: grants may be new."""
        async with self._lock:
            if self.node.closed:
                return
            await self.node.update()
            if len(self._offered) < len(self.resources):
                await self._follow(list(self.resources))

    async def close(self, reason: str) -> None:
        """End everything: at once what others see, then what the master knows."""
        self.node.cut(reason)
        async with self._lock:  # what is offered in this moment is withdrawn, too
            for resource in tuple(self._running):
                self._cancel(resource)
            await self.node.close(reason)

    # --- what is offered

    async def _offer(self, resource: Resource) -> None:
        try:
            match resource.kind:
                case kind if kind == PUBLISHER:
                    self._offered[resource] = await self.node.publish(resource.name, resource.type)
                case kind if kind == SUBSCRIBER:
                    subscriber = await self.node.subscribe(resource.name, resource.type)
                    self._offered[resource] = subscriber
                    self._tasks.spawn(self._write(resource, subscriber), f"{resource.name}: PUT")
                case kind if kind == SERVICE:
                    offered = service_type(resource.type)
                    await self.node.services.provide(
                        resource.name, offered, partial(self._call, resource, offered)
                    )
                    self._offered[resource] = None
        except (HintedError, OSError, TimeoutError, Fault) as error:
            _log.warning("%s: %s is not offered: %s", self.node.name, resource.name, error)

    async def _withdraw(self, resource: Resource) -> None:
        self._cancel(resource)
        offered = self._offered.pop(resource)
        if isinstance(offered, Subscriber):
            await offered.close()
        elif isinstance(offered, Publisher):
            await self.node.unpublish(resource.name)
        else:
            await self.node.services.withdraw(resource.name)

    def _cancel(self, resource: Resource) -> None:
        cancel = self._running.pop(resource, None)
        if cancel is not None:
            cancel()

    # --- messages

    def _notified(
        self, resource: Resource, publisher: Publisher, answer: Answer | ThingUnreachable
    ) -> None:
        if isinstance(answer, ThingUnreachable):
            self._running.pop(resource, None)
            _log.info("%s: %s", resource.name, answer)
            return
        self._seen.add(resource)
        try:
            message = _message(answer, resource, publisher.endpoint.type.layout)
            publisher.publish_bytes(message)
            self.received += 1
        except HintedError as error:
            self.refused += 1
            _log.info("%s: dropped a message: %s", resource.name, error)

    async def _write(self, resource: Resource, subscriber: Subscriber) -> None:
        """Write each message; while one is under way, only the newest of the others is kept."""
        async for data in subscriber.raw():
            try:
                body = from_ros(data, resource.format, subscriber.endpoint.type.layout)
                await self._answered(Request(codes.PUT, resource.path, body, resource.format))
            except HintedError as error:
                self.refused += 1
                _log.info("%s: not written: %s", resource.name, error)
            await asyncio.sleep(1 / MESSAGE_RATE)

    async def _call(
        self, resource: Resource, kind: ServiceType, request: Message, _caller: Identity
    ) -> Message:
        data = bytes(kind.request.serialize(request))
        try:
            body = from_ros(data, resource.format, kind.request_layout)
            asked = Request(codes.POST, resource.path, body, resource.format)
            async with asyncio.timeout(CALL_DEADLINE):
                answer = await self._answered(asked)
            return kind.response.deserialize(_message(answer, resource, kind.response_layout))
        except (BodyRefused, ThingUnreachable) as error:
            raise ServiceFailed(f"the thing does not answer: {error}") from error
        except TimeoutError:
            raise ServiceFailed("the thing does not answer in time") from None

    async def _answered(self, request: Request) -> Answer:
        """The answer of the thing.

        Raises:
            ThingUnreachable: none, or an error.
        """
        future: asyncio.Future[Answer] = asyncio.get_running_loop().create_future()
        cancel = self._ask(request, partial(_settle, future))
        if cancel is None:
            raise ThingUnreachable(f"{self.node.name} is not there")
        try:
            return await future
        finally:
            cancel()


def _settle(future: asyncio.Future[Answer], answer: Answer | ThingUnreachable) -> None:
    if future.done():
        return
    if isinstance(answer, ThingUnreachable):
        future.set_exception(answer)
    elif not answer.code.is_successful():
        future.set_exception(ThingUnreachable(f"it answers {answer.code.dotted}"))
    else:
        future.set_result(answer)


def _message(answer: Answer, resource: Resource, layout: Layout) -> bytes:
    """The ROS message in an answer.

    Raises:
        BodyRefused: an error, another format, or not one message.
    """
    if not answer.code.is_successful():
        raise BodyRefused(f"it answers {answer.code.dotted}")
    form: Any = resource.format if answer.format is None else answer.format
    if form != resource.format:
        raise BodyRefused(f"content format {form}, where it announced {resource.format}")
    return to_ros(answer.body, resource.format, layout)
