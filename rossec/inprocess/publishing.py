"""Publishing from rospy: one serialization, one treated copy per treatment.

`publish` does what `rospy.topics._PublisherImpl.publish` does, and between serializing and sending
asks each connection's guard. A connection without a link has no right, and gets nothing.
"""

import logging
from collections.abc import Hashable, Iterable
from contextlib import suppress
from typing import Any, Final

from rospy.core import is_shutdown
from rospy.exceptions import ROSException
from rospy.msg import serialize_message

from grants.errors import GrantError
from rossec.inprocess.links import Link, PlainLink
from rossec.inprocess.member import now
from rossec.inprocess.outbox import ALONE, LENGTH, Pieces
from rossec.inprocess.spare import Spare

_KEEP: Final = 16 * 1024 * 1024  # memory of larger messages is given back at once
_spare: Final = Spare(4)
_log = logging.getLogger("rossec.rospy")


def publish(topic: Any, message: Any, connection_override: Any = None) -> bool | None:
    """As `_PublisherImpl.publish`, the arguments the same."""
    if topic.closed:
        if not is_shutdown():
            raise ROSException("publish() to a closed topic")
        return None
    if topic.is_latch:
        topic.latch = message
    if not topic.has_connections():
        return False
    try:
        data = _serialized(topic, message)
    except ValueError:
        if not topic.closed:
            raise
        if is_shutdown():
            return None
        raise ROSException("topic was closed during publish()") from None
    connections = topic.connections if connection_override is None else [connection_override]
    for connection in _offer(topic.resolved_name, data, connections):
        with suppress(Exception):  # as rospy: a dead connection is dropped
            connection.close()
    return None


def _serialized(topic: Any, message: Any) -> bytes:
    if topic.buff.tell() > 0:  # its bytes were handed out; a closed one says so
        topic.buff = _spare.exchange(topic.buff)
    buffer = topic.buff
    size = 0
    topic.seq += 1
    try:
        serialize_message(buffer, topic.seq, message)
        buffer.truncate()
        data: bytes = buffer.getvalue()
        size = len(data)
        topic.message_data_sent += size
        return data
    finally:
        if not ALONE < size <= _KEEP and not buffer.closed:
            buffer.seek(0)
            buffer.truncate(0)


def _offer(name: str, data: bytes, connections: Iterable[Any]) -> list[Any]:
    """Give each connection what it may see; returns those that are dead."""
    treated: dict[Hashable, Pieces | None] = {}
    moment = now()
    dead = []
    for connection in connections:
        try:
            pieces = _for(name, data, connection, moment, treated)
            if pieces is not None and not is_shutdown():
                connection.write_data(pieces)
        except Exception:  # noqa: BLE001 - as rospy: whatever fails, the others get theirs
            dead.append(connection)
    return dead


def _for(
    name: str, data: bytes, connection: Any, moment: int, treated: dict[Hashable, Pieces | None]
) -> Pieces | None:
    sock = connection.socket
    link: Link | PlainLink | None = sock.link
    if link is None or moment >= link.ends:
        return None
    if link.guard is None:
        return data
    key = link.guard.key
    if key not in treated:
        treated[key] = _treat(name, link, data, moment)
    return treated[key]


def _treat(name: str, link: Link, data: bytes, moment: int) -> Pieces | None:
    assert link.guard is not None  # noqa: S101 - asked by the caller
    try:
        pieces = link.guard.treat(memoryview(data)[LENGTH.size :], moment)
    except GrantError as error:
        _log.warning("%s: withheld from %s: %s", name, link.stream.peer.name, error)
        return None
    if pieces is None:
        return None
    size = sum(map(len, pieces))
    whole = (LENGTH.pack(size), *pieces)
    return whole if size > ALONE else b"".join(whole)  # once, not for each connection
