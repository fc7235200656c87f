"""The topics of one node: its publishers and subscribers, and their registrations."""

import contextlib
import logging
from collections.abc import Mapping, Sequence
from itertools import count

from ca.domains.aliases import split_alias
from ca.errors import HintedError
from grants.filters import layout
from grants.memory import MemoryScope
from rossec.errors import ConfigurationError
from rossec.node.context import NodeContext
from rossec.node.publisher import Publisher
from rossec.node.subscriber import Subscriber
from rossec.participant.publisher_grace import PublisherGrace
from rossec.participant.remote_names import refuse_offer
from rossec.participant.topic_handshake import TopicEndpoint

_log = logging.getLogger("rossec.node")


class Topics:
    """Publishers by topic, and any number of subscribers."""

    def __init__(self, context: NodeContext, grace: PublisherGrace) -> None:
        self._context = context
        self._publishers: dict[str, Publisher] = {}
        self._subscribers: dict[str, list[Subscriber]] = {}
        self._grace = grace

    @property
    def publishers(self) -> Mapping[str, Publisher]:
        """What this node publishes, by topic."""
        return self._publishers

    @property
    def subscribers(self) -> list[Subscriber]:
        """What this node subscribes to."""
        return [item for items in self._subscribers.values() for item in items]

    async def publish(self, endpoint: TopicEndpoint, *, latch: bool, queue_size: int) -> Publisher:
        """Register a publisher.

        Raises:
            RossecError: a second publisher of the topic, a name below /remote, or the master
                refuses.
        """
        refuse_offer(endpoint.topic, "published")
        if endpoint.topic in self._publishers:
            raise ConfigurationError(f"{endpoint.topic} is published by this node already")
        shape = layout.parse(endpoint.type.name, endpoint.type.definition)
        publisher = Publisher(endpoint, shape, self._context, latch=latch, queue_size=queue_size)
        self._publishers[endpoint.topic] = publisher
        try:
            await self._register_publisher(publisher)
        except BaseException:
            del self._publishers[endpoint.topic]
            raise
        return publisher

    async def subscribe(self, endpoint: TopicEndpoint, *, queue_size: int) -> Subscriber:
        """Register a subscriber.

        Raises:
            NameRefused: a name below /remote that is no alias.
            RossecError: the master refuses.
        """
        split_alias(endpoint.topic)
        context = self._context
        existing = self._subscribers.setdefault(endpoint.topic, [])
        subscriber = Subscriber(
            endpoint,
            context,
            self._forget,
            _unused_memory_scope(context.memory_scope, existing),
            queue_size=queue_size,
        )
        existing.append(subscriber)
        try:
            await self._register_subscriber(subscriber)
        except BaseException:
            await subscriber.close()
            raise
        return subscriber

    def describe(self) -> dict[str, object]:
        """The topics with their types, for the slave API."""
        publications = [[item.topic, item.endpoint.type.name] for item in self.publishers.values()]
        subscriptions = [[item.topic, item.endpoint.type.name] for item in self.subscribers]
        return {"getSubscriptions": subscriptions, "getPublications": publications}

    def publishers_changed(self, topic: str, uris: list[str]) -> None:
        """Follow the master's list of publishers."""
        self._follow(topic, self._grace.update(topic, uris))

    def drop_expired_publishers(self) -> None:
        """Drop publishers that the master did not list again within the grace period."""
        for topic in self._grace.expired_topics():
            self._follow(topic, self._grace.to_follow(topic))

    def _follow(self, topic: str, uris: list[str]) -> None:
        for subscriber in self._subscribers.get(topic, []):
            subscriber.update(uris)

    async def restore(self) -> None:
        """Register everything again: the master was restarted, or there is a new grant."""
        for publisher in tuple(self._publishers.values()):
            with self._context.restoring(publisher.topic):
                await self._register_publisher(publisher)
        for subscriber in self.subscribers:
            with self._context.restoring(subscriber.topic):
                await self._register_subscriber(subscriber)

    async def close_subscribers(self) -> None:
        """Close every connection to a publisher."""
        for subscriber in self.subscribers:
            await subscriber.close()

    async def unregister(self) -> None:
        """Unregister the publishers."""
        try:
            for topic in self._publishers:
                await self._context.call("unregisterPublisher", topic, self._context.uri)
        except (HintedError, OSError, TimeoutError) as error:
            _log.info("%s: closed without unregistering: %s", self._context.name, error)

    async def _register_publisher(self, publisher: Publisher) -> None:
        endpoint = publisher.endpoint
        await self._context.call(
            "registerPublisher", endpoint.topic, endpoint.type.name, self._context.uri
        )

    async def _register_subscriber(self, subscriber: Subscriber) -> None:
        endpoint, uri = subscriber.endpoint, self._context.uri
        before = subscriber.updates
        uris = await self._context.call(
            "registerSubscriber", endpoint.topic, endpoint.type.name, uri
        )
        if isinstance(uris, list) and subscriber.updates == before:  # else there was an update
            named = [uri for uri in uris if isinstance(uri, str)]
            subscriber.update(self._grace.update(subscriber.topic, named))

    async def _forget(self, subscriber: Subscriber) -> None:
        """Remove a closed subscriber; the last one of its topic unregisters."""
        others = self._subscribers.get(subscriber.topic, [])
        if subscriber in others:
            others.remove(subscriber)
        if not others and self._subscribers.pop(subscriber.topic, None) is not None:
            self._grace.forget(subscriber.topic)
            with contextlib.suppress(HintedError, OSError):
                await self._context.call(
                    "unregisterSubscriber", subscriber.topic, self._context.uri
                )


def _unused_memory_scope(memory_scope: MemoryScope, existing: Sequence[Subscriber]) -> MemoryScope:
    """The memory of another subscriber of a topic, separate from those of the open ones.

    Each of them receives every message. A new one continues with the memory of a closed one.
    """
    used = {subscriber.memory_scope for subscriber in existing}
    scopes = (memory_scope.child(str(number)) for number in count())
    return next(scope for scope in scopes if scope not in used)
