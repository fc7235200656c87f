"""Publishing from rospy: one serialization, one filtered copy per distinct filter, and the send queues.

`publish` does what `rospy.topics._PublisherImpl.publish` does, and between serializing and sending
applies each connection's guard. `SendQueue` replaces rospy's `QueuedConnection`; `write_data` is for
connections without a queue.
"""

import logging
import socket
import struct
import time
from collections import deque
from collections.abc import Callable, Hashable, Iterable, Iterator
from contextlib import suppress
from io import BytesIO
from sys import getrefcount
from threading import Condition, Thread
from typing import Any, Final

from rospy.core import is_shutdown
from rospy.exceptions import ROSException, TransportTerminated
from rospy.impl.tcpros_service import TCPROSServiceClient
from rospy.msg import serialize_message
from rospy.service import ServiceException

from ca.errors import HintedError
from ca.names import shown
from grants.errors import GrantError
from grants.guard import Guard
from rossec import clock
from rossec.channel.records import Bytes
from rossec.channel.tuning import UNSENT
from rossec.inprocess.options import PlainConnection
from rossec.inprocess.process import RosConnection
from rossec.inprocess.sockets import RosSocket
from rossec.net.context import forget_in_children
from rossec.participant import delivery_options
from rossec.participant.delivery_options import (
    Deflatable,
    DeliveryOptions,
    Latch,
    RequestedRate,
    Sample,
    SharedDeflation,
)

_UNUSED: Final = 2  # references: the buffer's, and the argument of `getrefcount`
LENGTH: Final = struct.Struct("<I")
SEPARATE_UNIT: Final = 128 * 1024  # a longer message is sent as a separate unit
_BATCH: Final = 256 * 1024  # a longer unit only adds latency
_SMALL: Final = 16 * 1024  # the kernel has room for it, or is full
PAUSE: Final = 0.001  # seconds; messages at shorter intervals are batched
Pieces = bytes | tuple[Bytes, ...]  # a message with its length in front, whole or in parts
_deflation: Final = SharedDeflation()  # publishing calls the queues of one message in a row
_POOLED: Final = 16 * 1024 * 1024  # the memory of larger messages is freed at once
_LATCH: Final = "rossec_latch"  # an attribute set on rospy's topics
_FORKED: Final = (
    "this process was forked from a running node, and nobody receives what it publishes"
    " (hint: publish in the parent, or start another program with subprocess)"
)
Samples = Callable[[Guard], Iterable[Sample[bytes]]]  # what to try for a guard, until one passes
_log = logging.getLogger("rossec.rospy")


class BufferPool:
    """The last `count` buffers whose bytes were handed out; threads share it."""

    # New pages for a large message cost the publisher about as much as encrypting it.

    def __init__(self, count: int) -> None:
        self._buffers: deque[BytesIO] = deque(maxlen=count)

    def exchange(self, buffer: BytesIO) -> BytesIO:
        # The count of references affects speed only: a `BytesIO` never writes into bytes that are referenced
        # elsewhere, it copies them first.
        self._buffers.append(buffer)
        with suppress(IndexError):  # another thread took the last buffer
            for _ in range(len(self._buffers)):
                oldest = self._buffers.popleft()
                if getrefcount(oldest.getvalue()) == _UNUSED:
                    oldest.seek(0)
                    return oldest
                self._buffers.append(oldest)
        return BytesIO()


class SendQueue:
    """A connection with a queue: `write_data` never waits; a full queue drops the oldest.

    The sending thread takes all queued messages and sends them as one unit.
    """

    def __init__(self, connection: Any, queue_size: int) -> None:
        self._connection = connection
        self._queue: deque[Pieces] = deque(maxlen=queue_size if queue_size > 0 else None)
        self._filled = Condition()
        self._idle = False
        self._last = 0.0
        self._error: Exception | None = None
        self._connection.set_cleanup_callback(self._closed)
        self._thread = Thread(target=self._run, name="rossec send queue")
        self._thread.start()

    @property
    def socket(self) -> Any:
        # Read for each message: found by `__getattr__` it was 7 to 10 % of publishing 100 bytes.
        return self._connection.socket

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(self._connection, name)

    def write_data(self, data: Pieces) -> bool:
        if self._error is not None:
            error, self._error = self._error, None
            raise error
        # A small message after a pause goes in this thread if that does not block: switching threads costs
        # more time than the encryption.
        last, self._last = self._last, time.monotonic()
        if self._last > last + PAUSE and self._send_now(data):
            return True
        # Notified only when idle: a publisher that is faster than the network makes larger batches.
        self._queue.append(data)
        idle = self._idle
        if idle:
            with self._filled:
                self._idle = False
                self._filled.notify()
        if idle or _size(data) > SEPARATE_UNIT:  # its memory cannot be reused yet
            time.sleep(0)  # as rospy: lets the sending thread run
        return True

    def _send_now(self, data: Pieces) -> bool:
        if not isinstance(data, bytes) or len(data) > _SMALL:
            return False
        try:
            with self._filled:  # the sending thread waits meanwhile
                if not self._idle or self._queue or not write_now(self._connection, data):
                    return False
                if self._connection.socket.unsent:
                    self._queue.append(())  # an empty message: sending it sends the rest
                    self._idle = False
                    self._filled.notify()
            return True
        except (HintedError, OSError) as error:
            # Without the lock: closing takes rospy's topic lock, whose holder may wait here.
            raise _ended(self._connection, error) from error

    def _closed(self, _: Any) -> None:
        with self._filled:
            self._filled.notify()

    def _run(self) -> None:
        while not self._connection.done:
            with self._filled:
                self._idle = True  # set before the queue is checked, for what is queued just after
                while not self._queue and not self._connection.done:
                    self._filled.wait()
                    self._idle = True
                self._idle = False
            try:
                for batch in self._batches():
                    write(self._connection, batch)
            except Exception as error:  # noqa: BLE001 - as rospy: the publisher's next call raises it
                # Without what refers to frames, and so to messages, for who keeps it.
                error.__cause__ = error.__context__ = None
                self._error = error.with_traceback(None)

    def _batches(self) -> Iterator[list[Pieces]]:
        batch: list[Pieces] = []
        size = 0
        with suppress(IndexError):
            while True:
                message = self._queue.popleft()
                batch.append(message)
                size += _size(message)
                if size >= _BATCH:
                    yield batch
                    batch, size = [], 0
        if batch:
            yield batch


def _size(message: Pieces) -> int:
    return len(message) if isinstance(message, bytes) else sum(map(len, message))


def write(transport: Any, messages: list[Pieces]) -> None:
    """Send messages as one unit over a transport of rospy's."""
    sock = _socket(transport)
    pieces: list[Bytes] = []
    try:
        match messages:
            case [bytes() as message] if len(message) > SEPARATE_UNIT:  # its receiver need not copy it then
                pieces = [message]
                sock.send_unit(message[: LENGTH.size])
                sock.send_unit(memoryview(message)[LENGTH.size :])
            case [_, _, *_] if all(isinstance(each, bytes) for each in messages):
                pieces = [b"".join(messages)]  # type: ignore[arg-type]  # all are bytes
                sock.send_unit(*pieces)
            case _:
                for each in messages:
                    pieces += [each] if isinstance(each, bytes) else each
                sock.send_unit(*pieces)
        transport.stat_bytes += sum(map(len, pieces))
    except (HintedError, OSError) as error:
        raise _ended(transport, error) from error
    transport.stat_num_msg += len(messages)


def write_now(transport: Any, message: bytes) -> bool:
    """Send a small message if that does not block (`RosSocket.try_send`)."""
    sock = _socket(transport)
    if not sock.try_send(message):
        return False
    transport.stat_bytes += len(message)
    transport.stat_num_msg += not sock.unsent  # else it is counted with the rest
    return True


def _socket(transport: Any) -> RosSocket:
    sock: RosSocket | None = transport.socket
    if sock is None or transport.done:
        raise TransportTerminated("connection closed")
    return sock


def _ended(transport: Any, error: Exception) -> TransportTerminated:
    transport.close()
    return TransportTerminated(str(error))


def write_data(transport: Any, data: Pieces) -> bool:
    calls = isinstance(transport.protocol, TCPROSServiceClient)
    if isinstance(data, bytes):
        data = _filtered(transport, data)
    try:
        write(transport, [data])
    except TransportTerminated as error:
        if calls:
            raise ServiceException(f"transport error completing service call: {error}") from error
        raise
    return True


def _filtered(transport: Any, data: bytes) -> Pieces:
    service_filter = None if transport.socket is None else transport.socket.service_filter
    if service_filter is None:
        return data
    try:
        pieces: Pieces = service_filter.outgoing(data)
    except HintedError as error:
        if "persistent" in transport.protocol.headers:
            transport.write_buff.seek(0)  # rospy empties the buffer only after sending
            transport.write_buff.truncate(0)
        else:
            transport.close()  # rospy does not use it again
        raise ServiceException(f"rossec: {error}") from error
    return pieces


def queue_for(connection: Any, queue_size: int) -> SendQueue:
    options: DeliveryOptions = connection.socket.options
    if options:
        return OptionsQueue(connection, queue_size, options)
    return SendQueue(connection, queue_size)


class OptionsQueue(SendQueue):
    """For a subscriber with options: thinned out, the newest only, deflated. It has passed the guard."""

    def __init__(self, connection: Any, queue_size: int, options: DeliveryOptions) -> None:
        size = 1 if options.newest else queue_size
        self._waiting: deque[Deflatable] = deque(maxlen=size if size > 0 else None)
        self._options = options
        self._rate = None if options.rate is None else RequestedRate(options.rate)
        if options.newest:
            connection.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, UNSENT)
        super().__init__(connection, 1)

    def write_data(self, data: Pieces) -> bool:
        if self._error is not None:
            error, self._error = self._error, None
            raise error
        if self._rate is not None and not self._rate.admits(time.monotonic()):
            return True
        content = (memoryview(data)[LENGTH.size :],) if isinstance(data, bytes) else data[1:]
        self._waiting.append(_deflation.of(content, data))
        self._queue.append(())  # there is something: the thread looks here, and takes from there
        if self._idle:
            with self._filled:
                self._idle = False
                self._filled.notify()
        time.sleep(0)  # as rospy: lets the sending thread run
        return True

    def _batches(self) -> Iterator[list[Pieces]]:
        # The kernel takes no more than it can send soon; a message is deflated only when it is its turn.
        self._queue.clear()
        while self._waiting:  # nobody else takes from it
            message = self._waiting.popleft()
            pieces = (message.content(),) if self._options.deflate else message.pieces
            yield [(LENGTH.pack(sum(map(len, pieces))), *pieces)]


_buffer_pool: Final = BufferPool(4)


class _ForkedNode:
    def __init__(self) -> None:
        self._warn: Callable[[str], None] | None = None  # of a started node
        self.is_child = False
        forget_in_children(self)

    def start(self, warn: Callable[[str], None]) -> None:
        self._warn = warn

    def abandon(self) -> None:
        self.is_child = self._warn is not None

    def say(self) -> None:
        if self._warn is not None:
            self._warn(_FORKED)


forked_node: Final = _ForkedNode()


def publish(topic: Any, message: Any, connection_override: Any = None) -> bool | None:
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
        sample = latch.newest if latch is not None else None
        sample = sample or Sample(_serialized(topic, message))
    except ValueError:
        if not topic.closed:
            raise
        if is_shutdown():
            return None
        raise ROSException("topic was closed during publish()") from None
    if latch is not None:
        latch.newest = sample
    transports = topic.connections if connection_override is None else [connection_override]
    dead = _send(topic, sample, transports, None if connection_override is None else latch)
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
    # A new subscriber gets the message as it was published, not as the program changed it since.
    latch = _latch(topic)
    if new_subscriber is None or message is not topic.latch:
        latch.newest = None
    topic.latch = message
    return latch


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
    topic: Any, sample: Sample[bytes], transports: Iterable[Any], new_subscriber: Latch[bytes] | None = None
) -> list[Any]:
    samples: Samples = (lambda _: (sample,)) if new_subscriber is None else new_subscriber.candidates
    filtered: dict[Hashable, Pieces | None] = {}
    moment = clock.time()
    dead = []
    for transport in transports:
        try:
            connection: RosConnection | PlainConnection | None = transport.socket.connection
            # Not authorized (yet), or no more: it gets nothing.
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
            delivery_options.warn(_log, delivery_options.SENT, name, peer, error)
            continue
        if pieces is not None:
            if topic.is_latch:
                _latch(topic).record(guard, sample)
            size = sum(map(len, pieces))
            whole = (LENGTH.pack(size), *pieces)
            return whole if size > SEPARATE_UNIT else b"".join(whole)  # once, not for each connection
    return None
