"""Which things a border router serves now, and the ROS node of each: resources become topics and services.

A notification is published, a message is written by PUT (the newest, when the thing is slower), a
call is a POST. Rights, filters and conditions are those of the node, as for every other node. What
a thing sends that is no message of its type is dropped and counted.
"""

import asyncio
import logging
from collections.abc import Callable
from functools import partial
from typing import Any, Final, NamedTuple

from aiocoap.numbers import codes

from ca.certificates import Identity
from ca.errors import CAError, HintedError
from ca.revocation.trust_status import Revocations
from ca.things import ThingKey, ThingStatement
from grants.filters.layout import Layout
from rossec.border import constrained_node, conversations
from rossec.border.endpoint import CoapAnswer, CoapRequest, OnAnswer
from rossec.border.resources import PUBLISHER, SUBSCRIBER, Resource, from_ros, to_ros
from rossec.errors import BodyRefused, ServiceFailed, ThingUnreachable
from rossec.host.runner import TaskSet
from rossec.node.publisher import Publisher
from rossec.node.subscriber import Subscriber
from rossec.participant.message_types import Message
from rossec.participant.service_types import ServiceType, service_type
from rossec.ros.xmlrpc import Fault
from rossec.saved_statements import ThingFiles

_NANOSECONDS: Final = 10**9  # of a second
_log = logging.getLogger("rossec.border")
CALL_DEADLINE: Final = 30.0
Cancel = Callable[[], None]
Ask = Callable[[CoapRequest, OnAnswer], Cancel | None]  # None: the thing is not there


class ServedThing(NamedTuple):
    statement: ThingStatement
    secret: bytes  # empty: it has a key


class Roster:
    """The things of one border router: those of its statements that are valid and not revoked."""

    def __init__(self, files: ThingFiles, revocations: Revocations, clock: Callable[[], int]) -> None:
        self._files = files
        self._revocations: Final = revocations
        self._clock = clock
        self._things: dict[str, ServedThing] = {}
        self._keys: dict[bytes, list[str]] = {}
        self._secrets: dict[bytes, list[str]] = {}
        self._refused: dict[str, str] = {}
        self._read_at, self._read_second, self._settled = -1, 0, False

    def __len__(self) -> int:
        return len(self._things)

    @property
    def names(self) -> list[str]:
        return sorted(self._things)

    def statement(self, name: str) -> ThingStatement | None:
        found = self._things.get(name)
        return None if found is None else found.statement

    def reload(self) -> bool:
        try:
            changed = self._files.path.stat().st_mtime_ns
        except OSError:
            changed = 0
        now = self._clock()
        if changed == self._read_at and (self._settled or now == self._read_second):
            return False
        # A file system's clock has steps: what is written right after is not seen by the time.
        self._settled = changed // _NANOSECONDS < now - 1
        self._read_at, self._read_second = changed, now
        loaded = self._files.load()
        refused = {str(path): str(error) for path, error in loaded.refused.items()}
        things: dict[str, ServedThing] = {}
        for statement in sorted(loaded.statements.values(), key=lambda each: each.not_before):
            try:
                has_key = isinstance(statement.credential, ThingKey)
                secret = b"" if has_key else self._files.secret_of(statement)
                things[statement.name] = ServedThing(statement, secret)
            except (HintedError, OSError) as error:
                refused[statement.name] = str(error)
        for what, reason in refused.items():
            if self._refused.get(what) != reason:
                _log.warning("%s: %s", what, reason)
        self._refused, self._things = refused, things
        self._keys, self._secrets = {}, {}
        for name, (statement, secret) in things.items():
            kids = self._secrets if secret else self._keys
            kids.setdefault(statement.credential.kid, []).append(name)
        return True

    def by_key(self, kid: bytes) -> tuple[str, ThingKey] | None:
        self.reload()
        found = self._usable(self._keys, kid)
        if found is None or not isinstance(found.statement.credential, ThingKey):
            return None
        return found.statement.name, found.statement.credential

    def by_secret(self, kid: bytes) -> tuple[str, bytes] | None:
        self.reload()
        found = self._usable(self._secrets, kid)
        return None if found is None else (found.statement.name, found.secret)

    def is_served(self, name: str, credential: bytes) -> bool:
        # A thing that is there stays while it is not known whether something is revoked: its connections end
        # by their own rules.
        found = self._things.get(name)
        if found is None or found.statement.credential.thumbprint != credential:
            return False
        revoked = self._revocations.entries
        ends = found.statement.expires <= self._clock()
        return not ends and revoked.isdisjoint((found.statement.id, credential))

    def entries(self) -> list[bytes]:
        things = self._things.values()
        return [entry for statement, _ in things for entry in (statement.id, statement.credential.thumbprint)]

    def _usable(self, kids: dict[bytes, list[str]], kid: bytes) -> ServedThing | None:
        # By a statement that names this router's key (`saved_statements` checks that), in time, and known not
        # to be revoked; so is its credential, which the authority may revoke by itself. Unknown counts as no.
        for name in reversed(kids.get(kid, [])):
            found, now = self._things[name], self._clock()
            try:
                found.statement.check_time(now)
                self._revocations.check(found.statement.id, now)
                self._revocations.check(found.statement.credential.thumbprint, now)
            except CAError as error:
                _log.info("%s is not served: %s", name, error)
            else:
                return found
        return None


class ThingBridge:
    """One thing and its ROS node; `tasks`: of all things."""

    def __init__(self, node: constrained_node.ThingNode, credential: bytes, ask: Ask, tasks: TaskSet) -> None:
        self.node: Final = node
        self.credential: Final = credential
        self._ask, self._tasks = ask, tasks
        self._lock = asyncio.Lock()  # offering and closing take turns
        self._offered: dict[Resource, Publisher | Subscriber | None] = {}
        self._running: dict[Resource, Cancel] = {}
        self._seen: set[Resource] = set()
        self.resources: tuple[Resource, ...] = ()  # what it has, as it said last
        self.received = self.refused = 0  # messages of the thing: published, dropped

    @property
    def offered(self) -> int:
        return len(self._offered)

    async def follow(self, resources: list[Resource]) -> None:
        async with self._lock:
            await self._follow(resources)

    async def _follow(self, resources: list[Resource]) -> None:
        for resource in self._offered.keys() - set(resources):
            self._cancel(resource)
            offered = self._offered.pop(resource)
            if isinstance(offered, Subscriber):
                await offered.close()
            elif isinstance(offered, Publisher):
                await self.node.unpublish(resource.name)
            else:
                await self.node.services.withdraw(resource.name)
        self.resources = tuple(resources)
        for resource in resources:
            if resource not in self._offered and not self.node.closed:
                try:
                    await self._offer(resource)
                except (HintedError, OSError, TimeoutError, Fault) as error:
                    _log.warning("%s: %s is not offered: %s", self.node.name, resource.name, error)
        self.observe()

    async def _offer(self, resource: Resource) -> None:
        if resource.kind == PUBLISHER:
            self._offered[resource] = await self.node.publish(resource.name, resource.type)
        elif resource.kind == SUBSCRIBER:
            subscriber = await self.node.subscribe(resource.name, resource.type)
            self._offered[resource] = subscriber
            self._tasks.spawn(self._write(resource, subscriber), f"{resource.name}: PUT")
        else:
            kind = service_type(resource.type)
            await self.node.services.provide(resource.name, kind, partial(self._call, resource, kind))
            self._offered[resource] = None

    def observe(self) -> None:
        # Not again what sent notifications since the last time.
        for resource, publisher in self._offered.items():
            if isinstance(publisher, Publisher) and resource not in self._seen:
                self._cancel(resource)
                running = self._ask(
                    CoapRequest(codes.GET, resource.path, observe=True),
                    partial(self._notified, resource, publisher),
                )
                if running is not None:
                    self._running[resource] = running
        self._seen.clear()

    def lost(self) -> None:
        self._running.clear()
        self._seen.clear()

    async def update(self) -> None:
        async with self._lock:
            if self.node.closed:
                return
            await self.node.update()
            if len(self._offered) < len(self.resources):
                await self._follow(list(self.resources))

    async def close(self, reason: str) -> None:
        self.node.cut(reason)
        async with self._lock:  # what is offered in this moment is withdrawn, too
            for resource in tuple(self._running):
                self._cancel(resource)
            await self.node.close(reason)

    def _cancel(self, resource: Resource) -> None:
        cancel = self._running.pop(resource, None)
        if cancel is not None:
            cancel()

    # --- messages

    def _notified(
        self, resource: Resource, publisher: Publisher, answer: CoapAnswer | ThingUnreachable
    ) -> None:
        if isinstance(answer, ThingUnreachable):
            self._running.pop(resource, None)
            _log.info("%s: %s", resource.name, answer)
            return
        self._seen.add(resource)
        try:
            publisher.publish_bytes(_message(answer, resource, publisher.endpoint.type.layout))
            self.received += 1
        except HintedError as error:
            self.refused += 1
            _log.info("%s: dropped a message: %s", resource.name, error)

    async def _write(self, resource: Resource, subscriber: Subscriber) -> None:
        # Write each message; while one is under way, only the newest of the others is kept.
        async for data in subscriber.raw():
            try:
                body = from_ros(data, resource.format, subscriber.endpoint.type.layout)
                await self._answered(CoapRequest(codes.PUT, resource.path, body, resource.format))
            except HintedError as error:
                self.refused += 1
                _log.info("%s: not written: %s", resource.name, error)
            await asyncio.sleep(1 / conversations.MESSAGE_RATE)

    async def _call(
        self, resource: Resource, kind: ServiceType, request: Message, _caller: Identity
    ) -> Message:
        data = bytes(kind.request.serialize(request))
        try:
            body = from_ros(data, resource.format, kind.request_layout)
            asked = CoapRequest(codes.POST, resource.path, body, resource.format)
            async with asyncio.timeout(CALL_DEADLINE):
                answer = await self._answered(asked)
            return kind.response.deserialize(_message(answer, resource, kind.response_layout))
        except (BodyRefused, ThingUnreachable) as error:
            raise ServiceFailed(f"the thing does not answer: {error}") from error
        except TimeoutError:
            raise ServiceFailed("the thing does not answer in time") from None

    async def _answered(self, request: CoapRequest) -> CoapAnswer:
        future: asyncio.Future[CoapAnswer] = asyncio.get_running_loop().create_future()
        cancel = self._ask(request, partial(_settle, future))
        if cancel is None:
            raise ThingUnreachable(f"{self.node.name} is not there")
        try:
            return await future
        finally:
            cancel()


def _settle(future: asyncio.Future[CoapAnswer], answer: CoapAnswer | ThingUnreachable) -> None:
    if future.done():
        return
    if isinstance(answer, ThingUnreachable):
        future.set_exception(answer)
    elif not answer.code.is_successful():
        future.set_exception(ThingUnreachable(f"it answers {answer.code.dotted}"))
    else:
        future.set_result(answer)


def _message(answer: CoapAnswer, resource: Resource, layout: Layout) -> bytes:
    if not answer.code.is_successful():
        raise BodyRefused(f"it answers {answer.code.dotted}")
    form: Any = resource.format if answer.format is None else answer.format
    if form != resource.format:
        raise BodyRefused(f"content format {form}, where it announced {resource.format}")
    return to_ros(answer.body, resource.format, layout)
