"""A topic this node publishes: its subscribers, and what each may receive of a message.

A shell around the guards: a message is serialized once, filtered once per distinct filter, and queued per
subscriber. A full queue drops its oldest message, as rospy's does; what waits is sent together. A subscriber
whose guard cannot evaluate a message does not receive it.
"""

import asyncio
import logging
import struct
from collections import deque
from collections.abc import Callable, Hashable, Iterable, Sequence
from functools import partial
from typing import Any, Final, TypeAlias

from ca.certificates import Identity
from ca.names import shown
from grants.decision import Decision
from grants.errors import GrantError
from grants.filters.layout import Layout
from grants.guard import Guard, needed_keys
from rossec import clock
from rossec.channel.tuning import BATCH, JOIN_PIECES_BELOW
from rossec.errors import ConnectionHeaderRefused, NodeShutdown, RossecError
from rossec.net.aio import SecureStream
from rossec.node.context import NodeConnection, NodeContext
from rossec.node.subscriber import QUEUE_SIZE, check_queue_size
from rossec.participant import delivery_options
from rossec.participant.authorized import AuthorizedConnection
from rossec.participant.definitions import Definition, forwarded_definition, needs_definition
from rossec.participant.delivery_options import Latch, Sample
from rossec.participant.handshakes import TopicEndpoint
from rossec.participant.host_types import known_type
from rossec.participant.message_types import Message, MessageType
from rossec.ros.names import ANY_TYPE

LENGTH: Final = struct.Struct("<I")
PATIENCE: Final = 4.0
"""Seconds a handshake waits: a subscriber gives up after five (`HANDSHAKE_DEADLINE`)."""

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
        if len(self._queue) >= self._queue_size:
            self._queue.popleft()
            self.dropped += 1
        self._queue.append(pieces)
        self._wake.set()

    async def run(self) -> None:
        while True:
            await self._wake.wait()
            self._wake.clear()
            while self._queue:
                batch: list[bytes | bytearray | memoryview] = []
                size = 0
                while self._queue and size < BATCH:
                    pieces = self._queue.popleft()
                    length = sum(map(len, pieces))
                    batch.append(LENGTH.pack(length))
                    batch.extend(pieces)
                    size += LENGTH.size + length
                if size < JOIN_PIECES_BELOW * len(batch):
                    # By one call: sealing would look at each piece of each short message, and join them too.
                    batch = [b"".join(batch)]
                await self._stream.send(*batch)


async def until_closed(stream: SecureStream[Identity]) -> None:
    while True:  # a TCPROS subscriber sends nothing after its header
        await stream.receive()


class Publisher:
    """Publishes messages of one type on one topic. Made by `Node.publisher`."""

    def __init__(
        self,
        endpoint: TopicEndpoint,
        layout: Layout | None,
        context: NodeContext,
        *,
        latch: bool,
        queue_size: int = QUEUE_SIZE,
    ) -> None:
        check_queue_size(queue_size)
        self.endpoint = endpoint
        self.latch = latch
        self.links: dict[SubscriberConnection, SubscriberQueue | delivery_options.DeliveryQueue] = {}
        self._layout = layout
        self._context = context
        self._queue_size = queue_size
        self._latch: Latch[memoryview] = Latch()
        self._deflation = delivery_options.SharedDeflation()
        self._closed = False
        self._changed = asyncio.Event()

    @property
    def topic(self) -> str:
        return self.endpoint.topic

    def create(self, /, **fields: object) -> Message:
        return self.endpoint.type.create(**fields)

    def publish(self, message: Message) -> None:
        """Send `message` to every subscriber, each as its grant allows. Raises MessageError: a field holds a
        value of a wrong type; NodeShutdown: the node is closed."""
        self._publish(self.endpoint.type.serialize(message))

    def publish_bytes(self, data: bytes | memoryview) -> None:
        """Send a message that is serialized already (without its length prefix). A buffer that could still
        change is copied, so that the bytes checked are the bytes sent."""
        self._publish(memoryview(data if isinstance(data, bytes) else bytes(data)))

    def close(self) -> None:
        self._closed = True

    def cut(self, reason: str) -> None:
        for connection in tuple(self.links):
            connection.stream.abort(reason)

    async def ready(self) -> None:
        """Return when the type is known: at once, but for a raw publisher."""

    def _publish(self, view: memoryview) -> None:
        self._send(Sample(view), self._latch if self.latch else None)

    def _send(self, sample: Sample[memoryview], latch: Latch[memoryview] | None) -> None:
        if self._closed:
            raise NodeShutdown(f"{self.topic}: the node is closed", "publish before it ends")
        if latch is not None:
            latch.newest = sample
        filtered: dict[Hashable, Pieces | None] = {}
        now = clock.time()
        for connection, queue in tuple(self.links.items()):
            if connection.ends <= now:  # the watchdog is about to close it
                continue
            # Subscribers whose guards do the same share one filtered message.
            key = connection.guard.key
            if key not in filtered:
                filtered[key] = self._filter(connection, sample, now, latch)
            pieces = filtered[key]
            if pieces is None:
                queue.withheld += 1
            else:
                queue.enqueue(pieces)

    async def wait_for_subscribers(self, count: int = 1) -> None:
        while len(self.links) < count:
            self._changed.clear()
            await self._changed.wait()

    def guard(self, decision: Decision) -> Guard:
        """The guard that applies `decision` to the messages of this topic."""
        context = self._context
        keys = {name: context.filter_key(name) for name in needed_keys(decision.restrictions)}
        return Guard(self._shape(decision), decision, keys, context.memory_scope)

    def _rebuilt(self, options: delivery_options.DeliveryOptions, decision: Decision) -> Guard:
        delivery_options.check_carried_out(options, decision)
        return self.guard(decision)

    def _shape(self, _decision: Decision) -> Layout | None:
        # The layout of messages; None only if no restriction reads them.
        return self._layout

    async def serve(
        self,
        stream: SecureStream[Identity],
        decision: Decision,
        guard: Guard,
        answer: bytes,
        options: delivery_options.DeliveryOptions = delivery_options.NO_OPTIONS,
    ) -> None:
        """Answer one admitted subscriber and send it messages until its stream ends. It is registered before
        the answer is sent: a revocation received meanwhile closes it."""
        connection = AuthorizedConnection(stream, decision, guard, partial(self._rebuilt, options))
        queue = (
            delivery_options.DeliveryQueue(stream, options, self._queue_size, self._deflation)
            if options
            else SubscriberQueue(stream, self._queue_size)
        )
        self.links[connection] = queue
        self._links_changed()
        try:
            with self._context.connections.track(connection):
                await stream.send(answer)
                now = clock.time()
                for latch in self._latches():
                    for sample in latch.candidates(connection.guard):
                        pieces = self._filter(connection, sample, now, latch)
                        if pieces is not None:
                            queue.enqueue(pieces)
                            break
                async with asyncio.TaskGroup() as group:
                    group.create_task(until_closed(stream))
                    await queue.run()
        except* RossecError as group:
            _log.info("%s: %s left: %s", self.topic, shown(stream.peer.name), group.exceptions[0])
        finally:
            del self.links[connection]
            self._links_changed()

    def _links_changed(self) -> None:
        self._changed.set()

    def _latches(self) -> Iterable[Latch[memoryview]]:
        return (self._latch,)

    def _filter(
        self,
        connection: SubscriberConnection,
        sample: Sample[memoryview],
        now: float,
        latch: Latch[memoryview] | None,
    ) -> Pieces | None:
        try:
            pieces = connection.guard.apply(sample.data, now, sample.mark)
        except GrantError as error:
            delivery_options.warn(
                _log, delivery_options.SENT, self.topic, shown(connection.stream.peer.name), error
            )
            return None
        if latch is not None and pieces is not None:
            latch.record(connection.guard, sample)
        return pieces


class RawPublisher(Publisher):
    """Forwards messages of a type that others define. Made by `Topics.publish_raw`.

    A subscriber is authorized first, as ever; then its handshake waits, a limited time, until the type is
    known (`describe`). Several senders may be behind the topic: a new subscriber is sent the last message of
    each that latches, and the header says that the topic latches only while there is one, as a receiver takes
    the last message of a latching publisher for the value of the topic. Restrictions of a subscriber are
    applied by the sender's definition, where that is proven or this host's: they may protect the subscriber
    from the sender.
    """

    def __init__(
        self,
        topic: str,
        type_name: str,  # as registered; `*`: not known yet
        context: NodeContext,
        on_demand: Callable[[], None],  # called when `demand` has changed
        *,
        queue_size: int = QUEUE_SIZE,
    ) -> None:
        unknown = TopicEndpoint(topic, MessageType(type_name, ANY_TYPE, ""))
        super().__init__(unknown, None, context, latch=False, queue_size=queue_size)
        self.problem = ""  # why the type is not known, for the log of a subscriber that waited in vain
        self._on_demand = on_demand
        self._waiting = 0
        self._known = asyncio.Event()
        self._by_sender: dict[object, Latch[memoryview]] = {}

    @property
    def demand(self) -> int:
        return len(self.links) + self._waiting

    def describe(self, kind: Definition) -> None:
        """Say what the messages are; subscribers that wait are answered. At most once."""
        named = MessageType(kind.name, kind.md5sum, kind.definition)
        self.endpoint = TopicEndpoint(self.topic, named)
        self._known.set()

    def forward(self, sender: object, data: bytes, *, keep: bool) -> None:
        """Send a serialized message; with `keep` it is what new subscribers are sent first."""
        latch = self._by_sender.setdefault(sender, Latch()) if keep else None
        self._send(Sample(memoryview(data)), latch)

    def forget(self, sender: object) -> None:
        self._by_sender.pop(sender, None)

    async def ready(self) -> None:
        """Return when the type is known."""
        self._waiting += 1
        self._on_demand()
        try:
            async with asyncio.timeout(PATIENCE):
                await self._known.wait()
        except TimeoutError:
            raise ConnectionHeaderRefused(
                f"no publisher of {self.topic} can be reached", self.problem
            ) from None
        finally:
            self._waiting -= 1
            self._on_demand()
        if self._closed:
            raise NodeShutdown(f"{self.topic} is published no longer")

    def close(self) -> None:
        """Refuse messages and subscribers from now on, also those that wait."""
        super().close()
        self._by_sender.clear()
        self._known.set()

    def _shape(self, decision: Decision) -> Layout | None:
        if not needs_definition(decision):
            return None
        return forwarded_definition(self.endpoint.type, decision, known_type).layout

    def _links_changed(self) -> None:
        super()._links_changed()
        self._on_demand()

    def _latches(self) -> Iterable[Latch[Any]]:
        return tuple(self._by_sender.values())
