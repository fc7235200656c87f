"""A topic this node publishes: its subscribers, and what each may receive of a message.

A shell around the guards: a message is serialized once, filtered once per distinct filter, and
queued per subscriber; a full queue drops its oldest message, as rospy's does. A subscriber whose
guard cannot evaluate a message does not receive it.
"""

import asyncio
import logging
import struct
from collections import deque
from collections.abc import Hashable, Sequence
from typing import Final, TypeAlias

from ca.certificates import Identity
from ca.domains.aliases import shown
from grants.decision import Decision
from grants.errors import GrantError
from grants.filters.layout import Layout
from grants.guard import Guard, needed_keys
from rossec import clock
from rossec.errors import NodeShutdown, RossecError
from rossec.net import withheld_log
from rossec.net.aio import SecureStream
from rossec.node.context import NodeConnection, NodeContext
from rossec.node.subscriber import check_queue_size
from rossec.participant.connections import AuthorizedConnection
from rossec.participant.latch import Latch, Sample
from rossec.participant.message_types import Message
from rossec.participant.topic_handshake import TopicEndpoint

QUEUE_SIZE: Final = 10
_LENGTH: Final = struct.Struct("<I")
# Batching amortizes system calls; beyond this a unit only adds latency (measured optimum 256 KiB).
_BATCH: Final = 256 * 1024

Pieces = Sequence[bytes | bytearray | memoryview]
SubscriberConnection: TypeAlias = NodeConnection[Guard]
_log = logging.getLogger("rossec.node")


class SubscriberQueue:
    """The messages for one admitted subscriber."""

    def __init__(self, stream: SecureStream[Identity], queue_size: int) -> None:
        self.withheld = 0
        self._stream = stream
        self.dropped = 0
        self._queue: deque[Pieces] = deque()
        self._queue_size = queue_size
        self._wake = asyncio.Event()

    def enqueue(self, pieces: Pieces) -> None:
        """Queue one filtered message; the oldest is dropped when the queue is full."""
        if len(self._queue) >= self._queue_size:
            self._queue.popleft()
            self.dropped += 1
        self._queue.append(pieces)
        self._wake.set()

    async def run(self) -> None:
        """Send queued messages until the stream ends, which raises."""
        async with asyncio.TaskGroup() as group:
            group.create_task(self._until_closed())
            while True:
                await self._wake.wait()
                self._wake.clear()
                while self._queue:
                    await self._stream.send(*self._next_batch())

    async def _until_closed(self) -> None:
        while True:  # a TCPROS subscriber sends nothing after its header
            await self._stream.receive()

    def _next_batch(self) -> list[bytes | bytearray | memoryview]:
        batch: list[bytes | bytearray | memoryview] = []
        size = 0
        while self._queue and size < _BATCH:
            pieces = self._queue.popleft()
            length = sum(map(len, pieces))
            batch.append(_LENGTH.pack(length))
            batch.extend(pieces)
            size += _LENGTH.size + length
        return batch


class Publisher:
    """Publishes messages of one type on one topic. Made by `Node.publisher`."""

    def __init__(
        self,
        endpoint: TopicEndpoint,
        layout: Layout,
        context: NodeContext,
        *,
        latch: bool,
        queue_size: int = QUEUE_SIZE,
    ) -> None:
        check_queue_size(queue_size)
        self.endpoint = endpoint
        self.latch = latch
        self.links: dict[SubscriberConnection, SubscriberQueue] = {}
        self._layout = layout
        self._context = context
        self._queue_size = queue_size
        self._latch: Latch[memoryview] = Latch()
        self._closed = False
        self._changed = asyncio.Event()

    @property
    def topic(self) -> str:
        """Resolved topic name."""
        return self.endpoint.topic

    def create(self, **fields: object) -> Message:
        """A zero message of this topic's type with `fields` set."""
        return self.endpoint.type.create(**fields)

    def publish(self, message: Message) -> None:
        """Send `message` to every subscriber, each as its grant allows.

        Raises:
            MessageError: a field holds a value of a wrong type.
            NodeShutdown: the node is closed.
        """
        self._publish(self.endpoint.type.serialize(message))

    def publish_bytes(self, data: bytes | memoryview) -> None:
        """Send a message that is serialized already (without its length prefix).

        A buffer that could still change is copied, so that the bytes checked are the bytes sent.
        """
        self._publish(memoryview(data if isinstance(data, bytes) else bytes(data)))

    def close(self) -> None:
        """Refuse to publish from now on: the node is closed."""
        self._closed = True

    def _publish(self, view: memoryview) -> None:
        if self._closed:
            raise NodeShutdown(f"{self.topic}: the node is closed", "publish before it ends")
        sample = Sample(view)
        if self.latch:
            self._latch.newest = sample
        filtered: dict[Hashable, Pieces | None] = {}
        now = clock.now()
        for connection, queue in tuple(self.links.items()):
            if connection.ends <= now:  # the watchdog is about to close it
                continue
            key = connection.guard.key
            if key not in filtered:
                filtered[key] = self._filter(connection, sample, now)
            pieces = filtered[key]
            if pieces is None:
                queue.withheld += 1
            else:
                queue.enqueue(pieces)

    async def wait_for_subscribers(self, count: int = 1) -> None:
        """Return as soon as at least `count` subscribers are connected."""
        while len(self.links) < count:
            self._changed.clear()
            await self._changed.wait()

    def guard(self, decision: Decision) -> Guard:
        """The guard that applies `decision` to the messages of this topic.

        Raises:
            GrantError: its restrictions are for another message type.
            ConfigurationError: a key for pseudonyms cannot be read.
        """
        context = self._context
        keys = {name: context.filter_key(name) for name in needed_keys(decision.restrictions)}
        return Guard(self._layout, decision, keys, context.memory_scope)

    async def serve(
        self, stream: SecureStream[Identity], decision: Decision, guard: Guard, answer: bytes
    ) -> None:
        """Answer one admitted subscriber and send it messages until its stream ends.

        It is registered before the answer is sent: a revocation received meanwhile closes it.
        """
        connection = AuthorizedConnection(stream, decision, guard)
        queue = self.links[connection] = SubscriberQueue(stream, self._queue_size)
        self._changed.set()
        try:
            with self._context.connections.track(connection):
                await stream.send(answer)
                self._send_latched(connection, queue)
                await queue.run()
        except* RossecError as group:
            _log.info("%s: %s left: %s", self.topic, shown(stream.peer.name), group.exceptions[0])
        finally:
            del self.links[connection]
            self._changed.set()

    def _send_latched(self, connection: SubscriberConnection, queue: SubscriberQueue) -> None:
        now = clock.now()
        for sample in self._latch.candidates(connection.guard):
            pieces = self._filter(connection, sample, now)
            if pieces is not None:
                queue.enqueue(pieces)
                break

    def _filter(
        self, connection: SubscriberConnection, sample: Sample[memoryview], now: int
    ) -> Pieces | None:
        try:
            pieces = connection.guard.apply(sample.data, now, sample.mark)
        except GrantError as error:
            withheld_log.warn(
                _log, withheld_log.SENT, self.topic, shown(connection.stream.peer.name), error
            )
            return None
        if self.latch and pieces is not None:
            self._latch.record(connection.guard, sample)
        return pieces
