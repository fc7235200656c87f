"""A topic this node subscribes to: one connection to each publisher the master lists.

The master provides the addresses of publishers only. Their identity comes from the channel, their
right to publish from the grant they present. A publisher that refuses, or is refused, is tried
again with growing pauses for as long as the master lists it: a grant may arrive later.
"""

import asyncio
import logging
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import replace
from functools import partial
from typing import Final, TypeAlias

from ca.certificates import Identity
from ca.domains.aliases import shown
from ca.errors import HintedError
from grants.decision import Decision
from grants.errors import GrantError
from grants.guard import Guard
from grants.memory import MemoryScope
from rossec import clock
from rossec.errors import ConfigurationError, MessageError
from rossec.net import withheld_log
from rossec.net.aio import SecureStream
from rossec.net.aio.arrivals import next_messages
from rossec.net.aio.tasks import TaskSet
from rossec.net.bounds import message_limit, unit_limit
from rossec.node.context import NodeConnection, NodeContext
from rossec.node.wished_messages import WishedMessages, wished_messages
from rossec.participant.access import FIELD
from rossec.participant.authorized import AuthorizedConnection
from rossec.participant.definitions import Definition, size_of
from rossec.participant.deflating import OVERHEAD
from rossec.participant.header_fields import Fields
from rossec.participant.message_types import Message
from rossec.participant.topic_guard import guard_for
from rossec.participant.topic_handshake import TopicEndpoint, admit_publisher, subscriber_header
from rossec.participant.wire_names import granted_name
from rossec.participant.wishes import NO_WISHES, Wishes
from rossec.ros import header
from rossec.ros.framing import Framing
from rossec.ros.header import MESSAGE_LIMIT, FrameReader

QUEUE_SIZE: Final = 10
HANDSHAKE_DEADLINE: Final = 5.0
_FIRST_PAUSE: Final = 0.25
LONGEST_PAUSE: Final = 15.0

PublisherConnection: TypeAlias = NodeConnection[Guard | None]
OnClose = Callable[["Subscriber"], Awaitable[None]]
_log = logging.getLogger("rossec.node")


class Subscriber:
    """Receives messages of one type on one topic; iterate over it. Made by `Node.subscriber`."""

    def __init__(
        self,
        endpoint: TopicEndpoint,
        context: NodeContext,
        on_close: OnClose,
        memory_scope: MemoryScope,
        *,
        queue_size: int = QUEUE_SIZE,
        wishes: Wishes = NO_WISHES,
    ) -> None:
        check_queue_size(queue_size)
        self.endpoint = endpoint
        self.links: set[PublisherConnection] = set()
        self.refusals: deque[HintedError] = deque(maxlen=16)
        self.received = 0
        self.updates = 0
        self.memory_scope = memory_scope
        self._context = context
        self._on_close = on_close
        self._wishes = wishes
        self._size = size_of(endpoint.type)
        self._longest = message_limit(self._size, MESSAGE_LIMIT)
        self._task_set = TaskSet()
        self._tasks: dict[str, asyncio.Task[None]] = {}
        self._queue: deque[bytes] = deque(maxlen=queue_size)
        self._wake = asyncio.Event()
        self._closed = False
        self._last_reason = ""

    @property
    def topic(self) -> str:
        """Resolved topic name."""
        return self.endpoint.topic

    @property
    def publishers(self) -> list[str]:
        """The API URIs that the master lists, connected or not."""
        return list(self._tasks)

    def update(self, publishers: list[str]) -> None:
        """Connect to exactly `publishers` (API URIs), the master's list."""
        if self._closed:
            return
        self.updates += 1
        for uri in self._tasks.keys() - set(publishers):
            self._tasks.pop(uri).cancel()
        for uri in set(publishers) - self._tasks.keys():
            self._tasks[uri] = self._task_set.spawn(self._follow(uri), f"{self.topic} from {uri}")

    async def messages(self) -> AsyncIterator[Message]:
        """Messages as they arrive; ends when the node closes. A malformed one is dropped."""
        async for data in self.raw():
            try:
                message = self.endpoint.type.deserialize(data)
            except MessageError as error:
                withheld_log.warn(
                    _log, "%(where)s: dropped a message: %(cause)s", shown(self.topic), "", error
                )
            else:
                yield message

    def __aiter__(self) -> AsyncIterator[Message]:
        return self.messages()

    async def raw(self) -> AsyncIterator[bytes]:
        """Serialized messages as they arrive, without their length prefix."""
        while not self._closed:
            while self._queue:
                yield self._queue.popleft()
            self._wake.clear()
            await self._wake.wait()

    async def close(self) -> None:
        """Close every connection, end the iterators, unregister. Safe to call twice."""
        if self._closed:
            return
        self._closed = True
        self._wake.set()
        self._tasks.clear()
        await self._task_set.close()
        await self._on_close(self)

    async def _follow(self, uri: str) -> None:
        """Keep one publisher connected until the master no longer lists it."""
        pause = _FIRST_PAUSE
        while True:
            before = self.received
            try:
                await self._receive_from(uri)
            except Exception as error:  # noqa: BLE001 - after any error try again later
                self._record_failure(uri, error)
            pause = _FIRST_PAUSE if self.received > before else min(2 * pause, LONGEST_PAUSE)
            await asyncio.sleep(pause)

    async def _receive_from(self, uri: str) -> None:
        async with asyncio.timeout(HANDSHAKE_DEADLINE):
            stream = await self._context.dialer.topic(uri, self.topic)
            try:
                limit = self._longest + (OVERHEAD if self._wishes.deflate else 0)
                frames = FrameReader(limit, first=header.HEADER_LIMIT)
                connection, answer, early = await self._handshake(stream, frames)
                wished = wished_messages(self._wishes, answer, self._longest)
            except BaseException:
                stream.abort("the connection header was refused")
                raise
        self.links.add(connection)
        try:
            with self._context.connections.track(connection):
                self._opened(connection, answer)
                framing, messages = Framing(frames), early
                while True:
                    if wished is None:
                        self._deliver(connection, messages)
                    else:
                        await self._deliver_wished(connection, wished, messages)
                    messages = await next_messages(stream, framing)
        finally:
            self.links.discard(connection)
            stream.abort("no longer subscribed")
            self._ended(connection)

    async def _handshake(
        self, stream: SecureStream[Identity], frames: FrameReader
    ) -> tuple[PublisherConnection, Fields, list[bytes]]:
        context = self._context
        name = context.name_for(stream.peer)
        own = context.certified or context.name
        endpoint = replace(self.endpoint, topic=granted_name(stream.peer, self.topic, own))
        fields = subscriber_header(name, endpoint, context.access, clock.now())
        await stream.send(header.encode(fields | self._wishes.fields))
        units: list[bytes] = []
        while not units:
            units = frames.feed(await stream.receive())
        answer = header.decode(units[0])
        decision = admit_publisher(
            answer, stream.peer, endpoint.expected, context.access, clock.now()
        )
        stream.raise_unit_limit(unit_limit(self._size, MESSAGE_LIMIT))
        del answer[FIELD]  # what is kept of it needs no grants
        rebuild = partial(self._guard, answer)
        connection = AuthorizedConnection(stream, decision, rebuild(decision), rebuild)
        return connection, answer, units[1:]

    def _guard(self, answer: Fields, decision: Decision) -> Guard | None:
        """For the messages of the publisher that answered so."""
        kind = self._read_as(answer, decision)
        return guard_for(kind, decision, self._context.filter_key, self.memory_scope)

    # -- what a raw subscriber does in another way

    def _read_as(self, _answer: Fields, _decision: Decision) -> Definition:
        """The type by which messages of a publisher are checked."""
        return self.endpoint.type

    def _opened(self, connection: PublisherConnection, answer: Fields) -> None:
        """A publisher is connected, and nothing of it delivered yet."""

    def _ended(self, connection: PublisherConnection) -> None:
        """A publisher, opened or not, is connected no longer."""

    def _keep(self, _connection: PublisherConnection, messages: list[bytes]) -> None:
        """Keep what may be delivered."""
        self._queue.extend(messages)
        self._wake.set()

    def _deliver(self, connection: PublisherConnection, messages: list[bytes]) -> None:
        if connection.guard is not None:
            messages = self._filtered(
                connection.guard, messages, shown(connection.stream.peer.name), clock.time()
            )
        if messages:
            self.received += len(messages)
            self._keep(connection, messages)

    async def _deliver_wished(
        self, connection: PublisherConnection, wished: WishedMessages, contents: list[bytes]
    ) -> None:
        """One by one: of what is inflated no more than the queue holds is kept.

        It takes its time, in which the right may end.
        """
        for content in contents:
            messages = [await wished.inflated(content)]
            self._context.connections.check(connection)
            if connection.guard is not None:
                peer = shown(connection.stream.peer.name)
                messages = self._filtered(connection.guard, messages, peer, clock.time())
            if messages and wished.admits():
                self.received += 1
                self._keep(connection, messages)

    def _filtered(self, guard: Guard, messages: list[bytes], peer: str, now: float) -> list[bytes]:
        """The messages that the right of the publisher allows, filtered."""
        filtered = []
        for message in messages:
            try:
                pieces = guard(message, now)
            except GrantError as error:
                withheld_log.warn(_log, withheld_log.RECEIVED, shown(self.topic), peer, error)
            else:
                filtered += [] if pieces is None else [b"".join(pieces)]
        return filtered

    def _record_failure(self, uri: str, error: Exception) -> None:
        """Log a failure; the same one again at level INFO only, as every attempt may repeat it."""
        if isinstance(error, HintedError):
            self.refusals.append(error.bare())
        reason = f"{shown(self.topic)} from {uri}: {str(error) or type(error).__name__}"
        unexpected = not isinstance(error, HintedError | OSError)
        level = logging.INFO if reason == self._last_reason else logging.WARNING
        _log.log(level, "%s", reason, exc_info=error if unexpected else None)
        self._last_reason = reason


def check_queue_size(size: int) -> None:
    """Refuse a size below 1 (in rospy 0 means unbounded, but memory is not)."""
    if size < 1:
        raise ConfigurationError(f"a queue of {size} messages", "queue_size must be 1 or more")
