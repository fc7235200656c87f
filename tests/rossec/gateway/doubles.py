"""The topics of a node, in memory: what is published and subscribed, and by whom."""

import asyncio
from types import SimpleNamespace
from typing import Any

from rossec.errors import AnswerRefused
from rossec.gateway.rules import SourceCandidate, TopicRule
from rossec.node.publisher import Publisher, RawPublisher
from rossec.node.subscriber import RawReceiver, RawSource
from rossec.participant.definitions import Definition
from rossec.participant.delivery_options import NO_OPTIONS, DeliveryOptions

STRING = Definition("std_msgs/String", "992ce8a1687cec8c8bd883ec73ca41d1", "string data\n")
INT8 = Definition("std_msgs/Int8", "27ffa0c9c4b8fb8492252bcad9e5c57b", "int8 data\n")


def candidate(
    name: str = "/pose", options: DeliveryOptions = NO_OPTIONS, label: str = "ada"
) -> SourceCandidate:
    """A topic of another domain, as a rule covers it."""
    alias, served = f"/remote/{label}{name}", f"/gateway/{label}{name}"
    return SourceCandidate(alias, served, TopicRule(label, "/**", options), STRING.name)


def source(kind: Definition = STRING, *, latching: bool = False) -> RawSource:
    """A publisher of the origin."""
    return RawSource("/remote/ada/robot", kind, latching)


class Connection:
    """A subscriber here; for a publisher its right has ended, so that it is sent nothing."""

    ends = 0

    def __init__(self, abort: Any) -> None:
        self.stream = SimpleNamespace(abort=abort)


class ServedPublisher(RawPublisher):
    """Notes what it forwards; `here` subscribers are connected."""

    def __init__(self, *given: Any, **options: Any) -> None:
        super().__init__(*given, **options)
        self.sent: list[bytes] = []
        self.kept: dict[object, bytes] = {}
        self.was_cut = ""

    def subscribe(self) -> object:
        connection: Any = Connection(self._abort)
        queue: Any = None
        self.links[connection] = queue
        self._links_changed()
        return connection

    def leave(self, connection: Any) -> None:
        self.links.pop(connection, None)
        self._links_changed()

    def forward(self, sender: object, data: bytes, *, keep: bool) -> None:
        super().forward(sender, data, keep=keep)
        self.sent.append(data)
        if keep:
            self.kept[sender] = data

    def forget(self, sender: object) -> None:
        super().forget(sender)
        self.kept.pop(sender, None)

    def _abort(self, reason: str) -> None:
        self.was_cut = reason
        for connection in tuple(self.links):
            self.leave(connection)


class OriginSubscription:
    """A subscription at the origin, until it is closed."""

    def __init__(self, receiver: RawReceiver, options: DeliveryOptions) -> None:
        self.receiver, self.options = receiver, options
        self.sources: list[RawSource] = []
        self.is_open = True

    def connect(self, found: RawSource) -> RawSource:
        self.receiver.connected(found)
        self.sources.append(found)
        return found

    async def close(self) -> None:
        self.is_open = False
        for each in self.sources:
            self.receiver.disconnected(each)
        self.sources.clear()


class Topics:
    """The topics of a node whose master refuses what it is told to refuse."""

    def __init__(self) -> None:
        self.publishers: dict[str, ServedPublisher] = {}
        self.subscriptions: list[OriginSubscription] = []
        self.refuses: set[str] = set()
        self.restored = 0

    async def publish_raw(
        self, topic: str, type_name: str, on_demand: Any, *, queue_size: int
    ) -> RawPublisher:
        await asyncio.sleep(0)
        if topic in self.refuses:
            raise AnswerRefused(f"no right to publish {topic}")
        context: Any = SimpleNamespace()
        made = ServedPublisher(topic, type_name, context, on_demand, queue_size=queue_size)
        self.publishers[topic] = made
        return made

    async def unpublish(self, publisher: Publisher) -> None:
        publisher.close()
        publisher.cut("no longer published")
        del self.publishers[publisher.topic]

    async def subscribe_raw(
        self, topic: str, receiver: RawReceiver, *, options: DeliveryOptions
    ) -> OriginSubscription:
        await asyncio.sleep(0)
        if topic in self.refuses:
            raise AnswerRefused(f"no right to subscribe {topic}")
        self.subscriptions.append(OriginSubscription(receiver, options))
        return self.subscriptions[-1]

    async def restore(self) -> None:
        self.restored += 1

    @property
    def open(self) -> list[OriginSubscription]:
        """The subscriptions that are not closed."""
        return [each for each in self.subscriptions if each.is_open]
