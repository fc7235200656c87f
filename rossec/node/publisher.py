"""A topic this node publishes: its subscribers, and what each may receive of a message.

A shell around the guards: a message is serialized once, filtered once per distinct filter, and
queued per subscriber (`subscriber_queue`, `wish_queue`). A subscriber whose guard cannot evaluate a
message does not receive it.
"""

import asyncio
import logging
from collections.abc import Hashable, Iterable
from functools import partial
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
from rossec.node.subscriber_queue import Pieces, SubscriberQueue
from rossec.node.wish_queue import WishQueue
from rossec.participant.authorized import AuthorizedConnection
from rossec.participant.deflating import SharedDeflation
from rossec.participant.latch import Latch, Sample
from rossec.participant.message_types import Message
from rossec.participant.topic_handshake import TopicEndpoint
from rossec.participant.wishes import NO_WISHES, Wishes, check_carried_out

QUEUE_SIZE: Final = 10
SubscriberConnection: TypeAlias = NodeConnection[Guard]
_log = logging.getLogger("rossec.node")


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
        self.links: dict[SubscriberConnection, SubscriberQueue] = {}
        self._layout = layout
        self._context = context
        self._queue_size = queue_size
        self._latch: Latch[memoryview] = Latch()
        self._deflation = SharedDeflation()
        self._closed = False
        self._changed = asyncio.Event()

    @property
    def topic(self) -> str:
        """Resolved topic name."""
        return self.endpoint.topic

    def create(self, /, **fields: object) -> Message:
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

    def cut(self, reason: str) -> None:
        """End the connection with every subscriber; what is queued for them is not sent."""
        for connection in tuple(self.links):
            connection.stream.abort(reason)

    async def ready(self) -> None:
        """Return when the type is known: at once, but for a raw publisher."""

    def _publish(self, view: memoryview) -> None:
        self._send(Sample(view), self._latch if self.latch else None)

    def _send(self, sample: Sample[memoryview], latch: Latch[memoryview] | None) -> None:
        """Queue a message for every subscriber; `latch` keeps it for later ones."""
        if self._closed:
            raise NodeShutdown(f"{self.topic}: the node is closed", "publish before it ends")
        if latch is not None:
            latch.newest = sample
        filtered: dict[Hashable, Pieces | None] = {}
        now = clock.time()
        for connection, queue in tuple(self.links.items()):
            if connection.ends <= now:  # the watchdog is about to close it
                continue
            key = connection.guard.key
            if key not in filtered:
                filtered[key] = self._filter(connection, sample, now, latch)
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
        return Guard(self._shape(decision), decision, keys, context.memory_scope)

    def _rebuilt(self, wishes: Wishes, decision: Decision) -> Guard:
        """The guard for another decision on a connection with these wishes."""
        check_carried_out(wishes, decision)
        return self.guard(decision)

    def _shape(self, _decision: Decision) -> Layout | None:
        """The layout of messages; None only if no restriction reads them."""
        return self._layout

    async def serve(
        self,
        stream: SecureStream[Identity],
        decision: Decision,
        guard: Guard,
        answer: bytes,
        wishes: Wishes = NO_WISHES,
    ) -> None:
        """Answer one admitted subscriber and send it messages until its stream ends.

        It is registered before the answer is sent: a revocation received meanwhile closes it.
        """
        connection = AuthorizedConnection(stream, decision, guard, partial(self._rebuilt, wishes))
        queue = self.links[connection] = self._queue_for(stream, wishes)
        self._links_changed()
        try:
            with self._context.connections.track(connection):
                await stream.send(answer)
                self._send_latched(connection, queue)
                await queue.run()
        except* RossecError as group:
            _log.info("%s: %s left: %s", self.topic, shown(stream.peer.name), group.exceptions[0])
        finally:
            del self.links[connection]
            self._links_changed()

    def _links_changed(self) -> None:
        self._changed.set()

    def _latches(self) -> Iterable[Latch[memoryview]]:
        """What a new subscriber is sent first."""
        return (self._latch,)

    def _queue_for(self, stream: SecureStream[Identity], wishes: Wishes) -> SubscriberQueue:
        if wishes:
            return WishQueue(stream, self._queue_size, wishes, self._deflation)
        return SubscriberQueue(stream, self._queue_size)

    def _send_latched(self, connection: SubscriberConnection, queue: SubscriberQueue) -> None:
        now = clock.time()
        for latch in self._latches():
            for sample in latch.candidates(connection.guard):
                pieces = self._filter(connection, sample, now, latch)
                if pieces is not None:
                    queue.enqueue(pieces)
                    break

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
            withheld_log.warn(
                _log, withheld_log.SENT, self.topic, shown(connection.stream.peer.name), error
            )
            return None
        if latch is not None and pieces is not None:
            latch.record(connection.guard, sample)
        return pieces
