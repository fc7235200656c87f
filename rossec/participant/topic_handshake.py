"""The TCPROS handshake inside the channel, both sides, as pure functions on header fields.

The caller's name comes from its certificate, never from `callerid` alone; rights come from the
grants it presents. The peer is authorized before this node looks up the topic, so that without a
grant it cannot tell a topic that exists from one that does not (attack N6). Access gets the local
name of a topic, the header the origin's.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ca.certificates import Identity
from ca.domains.aliases import origin_of, shown
from grants.decision import Decision
from grants.model import Right
from rossec.errors import ConnectionHeaderRefused
from rossec.participant.access import FIELD
from rossec.participant.access_interfaces import HandshakeAccess
from rossec.participant.header_fields import Fields, check_caller, refuse_on_wire, text
from rossec.ros.names import ANY_TYPE

if TYPE_CHECKING:
    from rossec.participant.message_types import MessageType


@dataclass(frozen=True)
class TopicEndpoint:
    """A topic as this node sees it: its resolved name and its type."""

    topic: str
    type: "MessageType"

    @property
    def expected(self) -> "ExpectedTopic":
        """The topic and type the peer must have."""
        return ExpectedTopic(self.topic, self.type.name, self.type.md5sum)


@dataclass(frozen=True)
class ExpectedTopic:
    """A topic with the name and md5sum of its type; `*` matches any type."""

    topic: str
    type_name: str
    md5sum: str


def subscriber_header(
    caller: str, endpoint: TopicEndpoint, access: HandshakeAccess, now: int
) -> Fields:
    """Fields a subscriber sends first; they prove its right to subscribe."""
    return {
        "callerid": caller.encode(),
        "topic": origin_of(endpoint.topic).encode(),
        "type": endpoint.type.name.encode(),
        "md5sum": endpoint.type.md5sum.encode(),
        "message_definition": endpoint.type.octets,
        "tcp_nodelay": b"1",
        FIELD: access.present(Right.SUBSCRIBE, endpoint.topic, now),
    }


def publisher_header(
    caller: str, endpoint: TopicEndpoint, access: HandshakeAccess, now: int, *, latching: bool
) -> Fields:
    """Fields a publisher answers with; they prove its right to publish."""
    return {
        "callerid": caller.encode(),
        "topic": endpoint.topic.encode(),
        "type": endpoint.type.name.encode(),
        "md5sum": endpoint.type.md5sum.encode(),
        "message_definition": endpoint.type.octets,
        "latching": b"1" if latching else b"0",
        FIELD: access.present(Right.PUBLISH, endpoint.topic, now),
    }


def requested_topic(fields: Mapping[str, bytes]) -> str:
    """Topic a connecting subscriber asks for.

    Raises:
        ConnectionHeaderRefused: no topic, a name that is not text, or an alias.
    """
    return refuse_on_wire(text(fields, "topic"))


def admit_subscriber(
    fields: Mapping[str, bytes], peer: Identity, access: HandshakeAccess, now: int
) -> Decision:
    """Decide on a subscriber from its header, before anything about the topic is looked up.

    Raises:
        CallerMismatch, ConnectionHeaderRefused: the header does not fit the peer.
        GrantError, CAError: the peer may not subscribe.
    """
    check_caller(fields, peer)
    topic = requested_topic(fields)
    return access.authorize(peer, fields.get(FIELD), Right.SUBSCRIBE, topic, now)


def admit_publisher(
    fields: Mapping[str, bytes],
    peer: Identity,
    expected: ExpectedTopic,
    access: HandshakeAccess,
    now: int,
) -> Decision:
    """Decide on a publisher from the header it answered with.

    The caller applies the decision's restrictions to each message (`topic_guard.guard_for`), by the
    receiver's definition: the publisher's may differ under the same md5sum.

    Raises:
        CallerMismatch, ConnectionHeaderRefused: the topic, type or callerid does not match.
        GrantError, CAError: the peer may not publish.
    """
    if "error" in fields:
        raise ConnectionHeaderRefused(f"{shown(peer.name)} refuses: {text(fields, 'error')}")
    check_caller(fields, peer)
    if text(fields, "topic") != origin_of(expected.topic):
        raise ConnectionHeaderRefused(
            f"{shown(peer.name)} answers with another topic than {shown(expected.topic)}"
        )
    check_type(fields, expected)
    return access.authorize(peer, fields.get(FIELD), Right.PUBLISH, expected.topic, now)


def check_type(fields: Mapping[str, bytes], expected: ExpectedTopic) -> None:
    """Compare type and md5sum as TCPROS does; `*` matches any, on either side.

    Raises:
        ConnectionHeaderRefused: the two sides have different types.
    """
    name, md5sum = text(fields, "type"), text(fields, "md5sum")
    if not _matches(name, expected.type_name) or not _matches(md5sum, expected.md5sum):
        raise ConnectionHeaderRefused(
            f"{shown(expected.topic)} carries {expected.type_name} ({expected.md5sum}),"
            f" the peer expects {name} ({md5sum})",
            "both sides need the same version of the message package"
            if _matches(name, expected.type_name)
            else "name the type that the topic carries, or another topic",
        )


def _matches(one: str, other: str) -> bool:
    return ANY_TYPE in {one, other} or one == other
