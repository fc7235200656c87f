"""The topics of one node: its publishers and subscribers, and their registrations."""

import contextlib
import logging
from collections.abc import Callable
from itertools import count

from ca.errors import HintedError
from ca.names import split_alias
from grants.guard import MemoryScope
from rossec.errors import ConfigurationError
from rossec.node.context import NodeContext
from rossec.node.publisher import Publisher, RawPublisher
from rossec.node.subscriber import OnClose, RawReceiver, RawSubscriber, Subscriber
from rossec.participant.delivery_options import NO_OPTIONS, DeliveryOptions
from rossec.participant.handshakes import TopicEndpoint, refuse_offer
from rossec.participant.registrations import PublisherGrace

_log = logging.getLogger("rossec.node")


class Topics:
    def __init__(self, context: NodeContext, grace: PublisherGrace) -> None:
        self._context = context
        self.publishers: dict[str, Publisher] = {}
        self._subscribers: dict[str, list[Subscriber]] = {}
        self._grace = grace

    @property
    def subscribers(self) -> list[Subscriber]:
        return [item for items in self._subscribers.values() for item in items]

    async def publish(self, endpoint: TopicEndpoint, *, latch: bool, queue_size: int) -> Publisher:
        """Register a publisher."""
        publisher = Publisher(
            endpoint, endpoint.type.layout, self._context, latch=latch, queue_size=queue_size
        )
        await self._offer(publisher)
        return publisher

    async def publish_raw(
        self, topic: str, type_name: str, on_demand: Callable[[], None], *, queue_size: int
    ) -> RawPublisher:
        """Register a publisher whose type is described later; raises as `publish`."""
        publisher = RawPublisher(topic, type_name, self._context, on_demand, queue_size=queue_size)
        await self._offer(publisher)
        return publisher

    async def unpublish(self, publisher: Publisher) -> None:
        """Cut the subscribers of a publisher of this node, and unregister it. A master that is out of reach
        is not told: what is not published is not registered again."""
        if self.publishers.get(publisher.topic) is not publisher:
            return
        del self.publishers[publisher.topic]
        publisher.close()
        publisher.cut("no longer published")
        with contextlib.suppress(HintedError, OSError):
            await self._context.call("unregisterPublisher", publisher.topic, self._context.uri)

    async def _offer(self, publisher: Publisher) -> None:
        topic = publisher.topic
        refuse_offer(topic, "published")
        if topic in self.publishers:
            raise ConfigurationError(f"{topic} is published by this node already")
        self.publishers[topic] = publisher
        try:
            await self._register_publisher(publisher)
        except BaseException:
            if self.publishers.get(topic) is publisher:
                del self.publishers[topic]
            raise

    async def subscribe(
        self, endpoint: TopicEndpoint, *, queue_size: int, options: DeliveryOptions = NO_OPTIONS
    ) -> Subscriber:
        """Register a subscriber."""
        subscriber = Subscriber(
            endpoint, *self._for_subscriber(endpoint.topic), queue_size=queue_size, options=options
        )
        await self._listen(subscriber)
        return subscriber

    async def subscribe_raw(
        self, topic: str, receiver: RawReceiver, *, options: DeliveryOptions = NO_OPTIONS
    ) -> RawSubscriber:
        """Register a subscriber of any type, which hands on what arrives; raises as `subscribe`."""
        given = self._for_subscriber(topic)
        subscriber = RawSubscriber(topic, receiver, *given, options=options)
        await self._listen(subscriber)
        return subscriber

    def _for_subscriber(self, topic: str) -> tuple[NodeContext, OnClose, MemoryScope]:
        # Raises, before anything is kept, for a name below /remote that is no alias.
        split_alias(topic)
        existing = self._subscribers.setdefault(topic, [])
        memory_scope = self._context.memory_scope
        # Each of them receives every message. A new one continues with the memory of a closed one.
        used = {subscriber.memory_scope for subscriber in existing}
        scopes = (memory_scope.child(str(number)) for number in count())
        memory = next(scope for scope in scopes if scope not in used)
        return self._context, self._forget, memory

    async def _listen(self, subscriber: Subscriber) -> None:
        self._subscribers[subscriber.topic].append(subscriber)
        try:
            await self._register_subscriber(subscriber)
        except BaseException:
            await subscriber.close()
            raise

    def describe(self) -> dict[str, object]:
        publications = [[item.topic, item.endpoint.type.name] for item in self.publishers.values()]
        subscriptions = [[item.topic, item.endpoint.type.name] for item in self.subscribers]
        return {"getSubscriptions": subscriptions, "getPublications": publications}

    def publishers_changed(self, topic: str, uris: list[str]) -> None:
        self._follow(topic, self._grace.update(topic, uris))

    def drop_expired_publishers(self) -> None:
        """Drop publishers that the master did not list again within the grace period."""
        for topic in self._grace.expired_topics():
            self._follow(topic, self._grace.to_follow(topic))

    def _follow(self, topic: str, uris: list[str]) -> None:
        for subscriber in self._subscribers.get(topic, []):
            subscriber.update(uris)

    async def restore(self) -> None:
        for publisher in tuple(self.publishers.values()):
            with self._context.restoring(publisher.topic):
                await self._register_publisher(publisher)
        for subscriber in self.subscribers:
            with self._context.restoring(subscriber.topic):
                await self._register_subscriber(subscriber)

    async def close_subscribers(self) -> None:
        for subscriber in self.subscribers:
            await subscriber.close()

    async def unregister(self) -> None:
        try:
            for topic in self.publishers:
                await self._context.call("unregisterPublisher", topic, self._context.uri)
        except (HintedError, OSError, TimeoutError) as error:
            _log.info("%s: closed without unregistering: %s", self._context.name, error)

    async def _register_publisher(self, publisher: Publisher) -> None:
        endpoint = publisher.endpoint
        await self._context.call("registerPublisher", endpoint.topic, endpoint.type.name, self._context.uri)

    async def _register_subscriber(self, subscriber: Subscriber) -> None:
        endpoint, uri = subscriber.endpoint, self._context.uri
        before = subscriber.updates
        uris = await self._context.call("registerSubscriber", endpoint.topic, endpoint.type.name, uri)
        if isinstance(uris, list) and subscriber.updates == before:  # else there was an update
            named = [uri for uri in uris if isinstance(uri, str)]
            subscriber.update(self._grace.update(subscriber.topic, named))

    async def _forget(self, subscriber: Subscriber) -> None:
        others = self._subscribers.get(subscriber.topic, [])
        if subscriber in others:
            others.remove(subscriber)
        if not others and self._subscribers.pop(subscriber.topic, None) is not None:
            self._grace.forget(subscriber.topic)
            with contextlib.suppress(HintedError, OSError):
                await self._context.call("unregisterSubscriber", subscriber.topic, self._context.uri)
