"""Publishing from rospy: one serialization, one filtered copy per distinct filter.

`publish` does what `rospy.topics._PublisherImpl.publish` does, and between serializing and sending
applies each connection's guard. A connection that was not authorized gets nothing. A new subscriber
of a latching topic gets the message as it was published, not as the program changed it since.
"""

import logging
from collections.abc import Callable, Hashable, Iterable, Sequence
from contextlib import suppress
from typing import Any, Final

from rospy.core import is_shutdown
from rospy.exceptions import ROSException
from rospy.msg import serialize_message

from ca.domains.aliases import shown
from grants.errors import GrantError
from grants.filters.codegen import Buffer
from grants.guard import Guard
from rossec import clock
from rossec.inprocess.allow_plain import PlainConnection
from rossec.inprocess.buffer_pool import BufferPool
from rossec.inprocess.process import RosConnection
from rossec.inprocess.send_queue import LENGTH, SEPARATE_UNIT, Pieces
from rossec.net import withheld_log
from rossec.net.forks import forget_in_children
from rossec.participant.latch import Latch, Sample

_POOLED: Final = 16 * 1024 * 1024  # the memory of larger messages is freed at once
_buffer_pool: Final = BufferPool(4)
_LATCH: Final = "rossec_latch"  # an attribute set on rospy's topics

_FORKED: Final = (
    "this process was forked from a running node, and nobody receives what it publishes"
    " (hint: publish in the parent, or start another program with subprocess)"
)

Samples = Callable[[Guard], Iterable[Sample[bytes]]]  # what to try for a guard, until one passes
_log = logging.getLogger("rossec.rospy")


class _ForkedNode:
    """In a process that was forked from a started node: what it publishes goes nowhere."""

    def __init__(self) -> None:
        self._warn: Callable[[str], None] | None = None  # of a started node
        self.is_child = False
        forget_in_children(self)

    def start(self, warn: Callable[[str], None]) -> None:
        """The node of this process starts."""
        self._warn = warn

    def abandon(self) -> None:
        """In the child: rospy's threads and connections are the parent's."""
        self.is_child = self._warn is not None

    def say(self) -> None:
        """That it publishes in vain; the reporter says it once."""
        if self._warn is not None:
            self._warn(_FORKED)


forked_node: Final = _ForkedNode()


def publish(topic: Any, message: Any, connection_override: Any = None) -> bool | None:
    """As `_PublisherImpl.publish`, with the same arguments."""
    if forked_node.is_child:
        forked_node.say()
        return False
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
        dead = _send(topic, sample, topic.connections)
    else:
        dead = _send(topic, sample, [connection_override], latch)
    for transport in dead:
        with suppress(Exception):  # as rospy: a dead connection is dropped
            transport.close()
    return None


def _latch(topic: Any) -> Latch[bytes]:
    if not hasattr(topic, _LATCH):
        setattr(topic, _LATCH, Latch())
    latch: Latch[bytes] = getattr(topic, _LATCH)
    return latch


def _latched(topic: Any, message: Any, new_subscriber: Any) -> Latch[bytes]:
    """The topic's latch; it is empty if `message` is new to it."""
    latch = _latch(topic)
    if new_subscriber is None or message is not topic.latch:
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
    if topic.buff.tell() > 0:  # its bytes were handed out; a closed one raises
        topic.buff = _buffer_pool.exchange(topic.buff)
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
        if not SEPARATE_UNIT < size <= _POOLED and not buffer.closed:
            buffer.seek(0)
            buffer.truncate(0)


def _send(
    topic: Any,
    sample: Sample[bytes],
    transports: Iterable[Any],
    new_subscriber: Latch[bytes] | None = None,
) -> list[Any]:
    """Send each subscriber what it may see, a new one what is latched; returns failed ones."""
    samples: Samples = (
        (lambda _: (sample,)) if new_subscriber is None else new_subscriber.candidates
    )
    filtered: dict[Hashable, Pieces | None] = {}
    moment = clock.time()
    dead = []
    for transport in transports:
        try:
            connection: RosConnection | PlainConnection | None = transport.socket.connection
            if connection is None or moment >= connection.ends:
                continue
            pieces: Pieces | None = sample.data
            guard = connection.guard  # read once: another thread may put another in its place
            if guard is not None and not isinstance(connection, PlainConnection):
                if guard.key not in filtered:
                    peer = shown(connection.stream.peer.name)
                    filtered[guard.key] = _filter(topic, guard, peer, samples, moment)
                pieces = filtered[guard.key]
            if pieces is not None and not is_shutdown():
                transport.write_data(pieces)
        except Exception:  # noqa: BLE001 - as rospy: one that fails does not affect the others
            dead.append(transport)
    return dead


def _filter(topic: Any, guard: Guard, peer: str, samples: Samples, moment: float) -> Pieces | None:
    for sample in samples(guard):
        try:
            pieces = guard.apply(memoryview(sample.data)[LENGTH.size :], moment, sample.mark)
        except GrantError as error:
            name = topic.resolved_name
            withheld_log.warn(_log, withheld_log.SENT, name, peer, error)
            continue
        if pieces is not None:
            if topic.is_latch:
                _latch(topic).record(guard, sample)
            return _packed(pieces)
    return None


def _packed(pieces: Sequence[Buffer]) -> Pieces:
    size = sum(map(len, pieces))
    whole = (LENGTH.pack(size), *pieces)
    return whole if size > SEPARATE_UNIT else b"".join(whole)  # once, not for each connection
