"""A topic this node subscribes to: one connection to each publisher the master lists.

The master provides the addresses of publishers only. Their identity comes from the channel, their
right to publish from the grant they present. A publisher that refuses, or is refused, is tried
again with growing pauses for as long as the master lists it: a grant may arrive later.
"""

import asyncio
import logging
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Final, TypeAlias

from ca.certificates import Identity
from ca.domains.aliases import shown
from ca.errors import HintedError
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
from rossec.participant.connections import AuthorizedConnection
from rossec.participant.definitions import size_of
from rossec.participant.message_types import Message
from rossec.participant.topic_guard import guard_for
from rossec.participant.topic_handshake import TopicEndpoint, admit_publisher, subscriber_header
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
                frames = FrameReader(self._longest, first=header.HEADER_LIMIT)
                connection, early = await self._handshake(stream, frames)
            except BaseException:
                stream.abort("the connection header was refused")
                raise
        self.links.add(connection)
        try:
            with self._context.connections.track(connection):
                self._deliver(connection, early)
                framing = Framing(frames)
                while True:
                    self._deliver(connection, await next_messages(stream, framing))
        finally:
            self.links.discard(connection)
            stream.abort("no longer subscribed")

    async def _handshake(
        self, stream: SecureStream[Identity], frames: FrameReader
    ) -> tuple[PublisherConnection, list[bytes]]:
        context = self._context
        name = context.name_for(stream.peer)
        fields = subscriber_header(name, self.endpoint, context.access, clock.now())
        await stream.send(header.encode(fields))
        units: list[bytes] = []
        while not units:
            units = frames.feed(await stream.receive())
        answer = header.decode(units[0])
        decision = admit_publisher(
            answer, stream.peer, self.endpoint.expected, context.access, clock.now()
        )
        stream.raise_unit_limit(unit_limit(self._size, MESSAGE_LIMIT))
        guard = guard_for(self.endpoint.type, decision, context.filter_key, self.memory_scope)
        return AuthorizedConnection(stream, decision, guard), units[1:]

    def _deliver(self, connection: PublisherConnection, messages: list[bytes]) -> None:
        if connection.guard is not None:
            messages = self._filtered(
                connection.guard, messages, shown(connection.stream.peer.name), clock.now()
            )
        if messages:
            self.received += len(messages)
            self._queue.extend(messages)
            self._wake.set()

    def _filtered(self, guard: Guard, messages: list[bytes], peer: str, now: int) -> list[bytes]:
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
            self.refusals.append(error)
        reason = f"{shown(self.topic)} from {uri}: {str(error) or type(error).__name__}"
        unexpected = not isinstance(error, HintedError | OSError)
        level = logging.INFO if reason == self._last_reason else logging.WARNING
        _log.log(level, "%s", reason, exc_info=error if unexpected else None)
        self._last_reason = reason


def check_queue_size(size: int) -> None:
    """Refuse a size below 1 (in rospy 0 means unbounded, but memory is not)."""
    if size < 1:
        raise ConfigurationError(f"a queue of {size} messages", "queue_size must be 1 or more")
