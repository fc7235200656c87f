"""A topic whose type becomes known when somebody subscribes: messages are forwarded as bytes.

A subscriber is authorized first, as ever; then its handshake waits, a limited time, until the type
is known (`describe`). Several senders may be behind the topic: a new subscriber is sent the last
message of each that latches, and the header says that the topic latches only while there is one,
as a receiver takes the last message of a latching publisher for the value of the topic.
Restrictions of a subscriber are applied by the sender's definition, where that is proven or this
host's: they may protect the subscriber from the sender.
"""

import asyncio
from collections.abc import Callable, Iterable
from typing import Any, Final

from grants.decision import Decision
from grants.filters.layout import Layout
from rossec.errors import ConnectionHeaderRefused, NodeShutdown
from rossec.node.context import NodeContext
from rossec.node.publisher import QUEUE_SIZE, Publisher
from rossec.participant.definitions import Definition, forwarded_definition, needs_definition
from rossec.participant.host_types import known_type
from rossec.participant.latch import Latch, Sample
from rossec.participant.message_types import MessageType
from rossec.participant.topic_handshake import TopicEndpoint
from rossec.ros.names import ANY_TYPE

PATIENCE: Final = 4.0
"""Seconds a handshake waits: a subscriber gives up after five (`HANDSHAKE_DEADLINE`)."""


class RawPublisher(Publisher):
    """Forwards messages of a type that others define. Made by `Topics.publish_raw`.

    Args:
        type_name: as registered; `*`: not known yet.
        on_demand: called when `demand` has changed.

    Attributes:
        problem: why the type is not known, for the log of a subscriber that waited in vain.
    """

    def __init__(
        self,
        topic: str,
        type_name: str,
        context: NodeContext,
        on_demand: Callable[[], None],
        *,
        queue_size: int = QUEUE_SIZE,
    ) -> None:
        unknown = TopicEndpoint(topic, MessageType(type_name, ANY_TYPE, ""))
        super().__init__(unknown, None, context, latch=False, queue_size=queue_size)
        self.problem = ""
        self._on_demand = on_demand
        self._waiting = 0
        self._known = asyncio.Event()
        self._by_sender: dict[object, Latch[memoryview]] = {}

    @property
    def demand(self) -> int:
        """How many subscribers are connected, or wait until the type is known."""
        return len(self.links) + self._waiting

    @property
    def is_described(self) -> bool:
        """Whether the type is known."""
        return self._known.is_set()

    def describe(self, kind: Definition) -> None:
        """Say what the messages are; subscribers that wait are answered. At most once."""
        named = MessageType(kind.name, kind.md5sum, kind.definition)
        self.endpoint = TopicEndpoint(self.topic, named)
        self._known.set()

    def forward(self, sender: object, data: bytes, *, keep: bool) -> None:
        """Send a serialized message; with `keep` it is what new subscribers are sent first.

        Raises:
            NodeShutdown: the node is closed, or the topic is no longer published.
        """
        latch = self._by_sender.setdefault(sender, Latch()) if keep else None
        self._send(Sample(memoryview(data)), latch)

    def forget(self, sender: object) -> None:
        """A sender is gone, and its last message with it."""
        self._by_sender.pop(sender, None)

    async def ready(self) -> None:
        """Return when the type is known.

        Raises:
            ConnectionHeaderRefused: it did not become known in time.
            NodeShutdown: the topic is no longer published.
        """
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
