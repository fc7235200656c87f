"""Publishing from rospy: one serialization, one treated copy per treatment.

`publish` does what `rospy.topics._PublisherImpl.publish` does, and between serializing and sending
asks each connection's guard. A connection without a link has no right, and gets nothing. What a
latching topic shows a newcomer is what it published, not what has become of the message since.
"""

import logging
from collections.abc import Callable, Hashable, Iterable, Sequence
from contextlib import suppress
from typing import Any, Final

from rospy.core import is_shutdown
from rospy.exceptions import ROSException
from rospy.msg import serialize_message

from grants.errors import GrantError
from grants.filters.codegen import Buffer
from grants.guard import Guard
from rossec.inprocess.buffer_pool import BufferPool
from rossec.inprocess.identity import now
from rossec.inprocess.live_connections import LiveConnection, PlainConnection
from rossec.inprocess.send_queue import ALONE, LENGTH, Pieces
from rossec.net import withheld_log
from rossec.participant.latch import Latch, Sample

_KEEP: Final = 16 * 1024 * 1024  # memory of larger messages is given back at once
_spare: Final = BufferPool(4)
_LATCH: Final = "rossec_latch"  # the attribute of a topic of rospy's

Samples = Callable[[Guard], Iterable[Sample[bytes]]]  # what to try for a guard, until one passes
_log = logging.getLogger("rossec.rospy")


def publish(topic: Any, message: Any, connection_override: Any = None) -> bool | None:
    """As `_PublisherImpl.publish`, the arguments the same."""
    if topic.closed:
        if not is_shutdown():
            raise ROSException("publish() to a closed topic")
        return None
    latch = _latched(topic, message, connection_override) if topic.is_latch else None
    if not topic.has_connections():
        return False
    try:
        sample = _sample(topic, message, latch)
    except ValueError:
        if not topic.closed:
            raise
        if is_shutdown():
            return None
        raise ROSException("topic was closed during publish()") from None
    if connection_override is None:
        dead = _offer(topic, sample, topic.connections)
    else:
        dead = _offer(topic, sample, [connection_override], latch)
    for connection in dead:
        with suppress(Exception):  # as rospy: a dead connection is dropped
            connection.close()
    return None


def _latch(topic: Any) -> Latch[bytes]:
    if not hasattr(topic, _LATCH):
        setattr(topic, _LATCH, Latch())
    latch: Latch[bytes] = getattr(topic, _LATCH)
    return latch


def _latched(topic: Any, message: Any, newcomer: Any) -> Latch[bytes]:
    """What the topic shows newcomers; nothing as yet if it does not know `message`."""
    latch = _latch(topic)
    if newcomer is None or message is not topic.latch:
        latch.newest = None
    topic.latch = message
    return latch


def _sample(topic: Any, message: Any, latch: Latch[bytes] | None) -> Sample[bytes]:
    if latch is None:
        return Sample(_serialized(topic, message))
    if latch.newest is None:
        latch.newest = Sample(_serialized(topic, message))
    return latch.newest


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


def _offer(
    topic: Any,
    sample: Sample[bytes],
    connections: Iterable[Any],
    newcomer: Latch[bytes] | None = None,
) -> list[Any]:
    """Give each connection what it may see, a newcomer what the latch shows; returns the dead."""
    samples: Samples = (lambda _: (sample,)) if newcomer is None else newcomer.candidates
    treated: dict[Hashable, Pieces | None] = {}
    moment = now()
    dead = []
    for connection in connections:
        try:
            link: LiveConnection | PlainConnection | None = connection.socket.link
            if link is None or moment >= link.ends:
                continue
            pieces: Pieces | None = sample.data
            if link.guard is not None:
                key = link.guard.key
                if key not in treated:
                    treated[key] = _treat(topic, link, samples, moment)
                pieces = treated[key]
            if pieces is not None and not is_shutdown():
                connection.write_data(pieces)
        except Exception:  # noqa: BLE001 - as rospy: whatever fails, the others get theirs
            dead.append(connection)
    return dead


def _treat(topic: Any, link: LiveConnection, samples: Samples, moment: int) -> Pieces | None:
    guard = link.guard
    assert guard is not None  # noqa: S101 - asked by the caller
    for sample in samples(guard):
        try:
            pieces = guard.apply(memoryview(sample.data)[LENGTH.size :], moment, sample.mark)
        except GrantError as error:
            name = topic.resolved_name
            withheld_log.warn(_log, withheld_log.SENT, name, link.stream.peer.name, error)
            continue
        if pieces is not None:
            if topic.is_latch:
                _latch(topic).record(guard, sample)
            return _packed(pieces)
    return None


def _packed(pieces: Sequence[Buffer]) -> Pieces:
    size = sum(map(len, pieces))
    whole = (LENGTH.pack(size), *pieces)
    return whole if size > ALONE else b"".join(whole)  # once, not for each connection
