"""A topic of any type, whose messages are taken as they come: bytes, by publisher.

Type and md5sum of the subscription are `*`, as in ROS; what a publisher answers with says what its
messages are, and is handed on with them. Nothing of it is trusted: where a right of the publisher
is restricted, the restriction is applied by the definition that is installed here, as for every
receiver of any type (`participant/definitions.py`). There is no queue: a receiver takes each
message at once, or leaves it.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Protocol

from grants.decision import Decision
from grants.filters.layout import MAX_TEXT, TYPE_NAME
from rossec.errors import ConnectionHeaderRefused
from rossec.node.subscriber import PublisherConnection, Subscriber
from rossec.participant.definitions import Definition, from_header, receiver_definition
from rossec.participant.header_fields import Fields
from rossec.participant.host_types import known_type
from rossec.participant.message_types import MessageType
from rossec.participant.topic_handshake import TopicEndpoint
from rossec.ros.names import ANY_TYPE

ANY: Final = MessageType(ANY_TYPE, ANY_TYPE, "")
_MD5: Final = re.compile(r"[0-9a-f]{32}")


@dataclass(frozen=True, eq=False)
class RawSource:
    """A publisher that is connected.

    Attributes:
        peer: its certified name, of a foreign one its alias.
        type: of its messages, as it claims.
        latching: whether it sends new subscribers the last message, as it claims.
    """

    peer: str
    type: Definition
    latching: bool


class RawReceiver(Protocol):
    """What takes messages; each publisher is connected once, then gone once."""

    def connected(self, source: RawSource) -> None:
        """A publisher is connected.

        Raises:
            HintedError: it is not wanted; it is tried again later.
        """

    def received(self, source: RawSource, messages: Sequence[bytes]) -> None:
        """Serialized messages, without their length prefixes."""

    def disconnected(self, source: RawSource) -> None:
        """A publisher is connected no longer."""

    def refused(self, error: Exception) -> None:
        """A publisher could not be connected, or the connection ended."""


class RawSubscriber(Subscriber):
    """Hands what arrives to a receiver. Made by `Topics.subscribe_raw`."""

    def __init__(self, topic: str, receiver: RawReceiver, *given: Any, **options: Any) -> None:
        """`given`, `options`: those of a subscriber, after its endpoint."""
        super().__init__(TopicEndpoint(topic, ANY), *given, **options)
        self._receiver = receiver
        self._sources: dict[PublisherConnection, RawSource] = {}

    def _read_as(self, answer: Fields, decision: Decision) -> Definition:
        return receiver_definition(ANY, claimed(answer), decision, known_type)

    def _opened(self, connection: PublisherConnection, answer: Fields) -> None:
        latching = answer.get("latching") == b"1"
        source = RawSource(connection.stream.peer.name, claimed(answer), latching)
        self._receiver.connected(source)
        self._sources[connection] = source

    def _keep(self, connection: PublisherConnection, messages: list[bytes]) -> None:
        self._receiver.received(self._sources[connection], messages)

    def _ended(self, connection: PublisherConnection) -> None:
        if (source := self._sources.pop(connection, None)) is not None:
            self._receiver.disconnected(source)

    def _record_failure(self, uri: str, error: Exception) -> None:
        super()._record_failure(uri, error)
        self._receiver.refused(error)


def claimed(answer: Fields) -> Definition:
    """The type a publisher says its messages have, in form.

    Raises:
        ConnectionHeaderRefused: it is not one type of ROS, or its definition is too long.
    """
    found = from_header(answer)
    if TYPE_NAME.fullmatch(found.name) is None or _MD5.fullmatch(found.md5sum) is None:
        raise ConnectionHeaderRefused(f"a publisher of {found.name[:80]!a}, which is no type")
    if len(found.definition) > MAX_TEXT:
        raise ConnectionHeaderRefused(f"a definition of {len(found.definition)} characters")
    return found
