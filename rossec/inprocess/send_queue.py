"""Sending over rospy's connections: queued messages are sent as one unit.

`SendQueue` replaces rospy's `QueuedConnection`; `write_data` is for connections without a queue.
"""

import struct
import time
from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from threading import Condition, Thread
from typing import Any, Final

from rospy.exceptions import TransportTerminated
from rospy.impl.tcpros_service import TCPROSServiceClient
from rospy.service import ServiceException

from ca.errors import HintedError
from rossec.channel.records import Bytes
from rossec.inprocess.sockets import RosSocket

LENGTH: Final = struct.Struct("<I")
SEPARATE_UNIT: Final = 128 * 1024  # a longer message is sent as a separate unit
_BATCH: Final = 256 * 1024  # a longer unit only adds latency
_SMALL: Final = 16 * 1024  # the kernel has room for it, or is full
PAUSE: Final = 0.001  # seconds; messages at shorter intervals are batched

Pieces = bytes | tuple[Bytes, ...]
"""A message with its length in front, whole or in parts."""


class SendQueue:
    """A connection with a queue: `write_data` never waits; a full queue drops the oldest.

    The sending thread takes all queued messages and sends them as one unit. It is notified only
    when idle: a publisher that is faster than the network makes larger batches. A small message
    after a pause is sent in the publisher's thread if that does not block: switching threads costs
    more time than the encryption.
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
        """The connection's socket; rospy reads it for each message."""
        return self._connection.socket

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(self._connection, name)

    def write_data(self, data: Pieces) -> bool:
        """Queue a message.

        Raises:
            Exception: what an earlier one failed with.
        """
        if self._error is not None:
            error, self._error = self._error, None
            raise error
        last, self._last = self._last, time.monotonic()
        if self._last > last + PAUSE and self._send_now(data):
            return True
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
        """Whether `data` was sent directly: the queue is empty, and sending does not block."""
        if not isinstance(data, bytes) or len(data) > _SMALL:
            return False
        try:
            return self._send_in_turn(data)
        except (HintedError, OSError) as error:
            # Without the lock: closing takes rospy's topic lock, whose holder may wait here.
            raise _ended(self._connection, error) from error

    def _send_in_turn(self, data: bytes) -> bool:
        with self._filled:  # the sending thread waits meanwhile
            if not self._idle or self._queue or not write_now(self._connection, data):
                return False
            if self._connection.socket.unsent:
                self._queue.append(())  # an empty message: sending it sends the rest
                self._idle = False
                self._filled.notify()
        return True

    def _closed(self, _: Any) -> None:
        with self._filled:
            self._filled.notify()

    def _run(self) -> None:
        while not self._connection.done:
            with self._filled:
                self._wait()
            try:
                self._send_waiting()
            except Exception as error:  # noqa: BLE001 - as rospy: the publisher's next call raises it
                self._error = _bare(error)

    def _send_waiting(self) -> None:
        for batch in _batches(self._queue):
            write(self._connection, batch)

    def _wait(self) -> None:
        """Until there is something to send, or the connection ends; the lock is held."""
        self._idle = (
            True  # set before the queue is checked, for a message that is queued just after
        )
        while not self._queue and not self._connection.done:
            self._filled.wait()
            self._idle = True
        self._idle = False


def _bare(error: Exception) -> Exception:
    """Without what refers to frames, and so to messages, for who keeps it."""
    error.__cause__ = error.__context__ = None
    return error.with_traceback(None)


def _size(message: Pieces) -> int:
    return len(message) if isinstance(message, bytes) else sum(map(len, message))


def _batches(queue: deque[Pieces]) -> Iterator[list[Pieces]]:
    """Take messages from the front, as many as make a unit; others may be added meanwhile."""
    batch: list[Pieces] = []
    size = 0
    with suppress(IndexError):
        while True:
            message = queue.popleft()
            batch.append(message)
            size += _size(message)
            if size >= _BATCH:
                yield batch
                batch, size = [], 0
    if batch:
        yield batch


def write(transport: Any, messages: list[Pieces]) -> None:
    """Send messages as one unit over a transport of rospy's.

    Raises:
        TransportTerminated: the connection has ended; the transport is closed.
    """
    sock = _socket(transport)
    try:
        transport.stat_bytes += _send(sock, messages)
    except (HintedError, OSError) as error:
        raise _ended(transport, error) from error
    transport.stat_num_msg += len(messages)


def write_now(transport: Any, message: bytes) -> bool:
    """Send a small message if that does not block (`RosSocket.try_send`).

    Raises:
        TransportTerminated: the connection was closed.
        HintedError, OSError: it has ended, and must be closed.
    """
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


def _send(sock: RosSocket, messages: list[Pieces]) -> int:
    """Send messages; a large one is a unit without its length, which is sent before it.

    Its receiver need not copy it then.
    """
    match messages:
        case [bytes() as message] if len(message) > SEPARATE_UNIT:
            sock.send_unit(message[: LENGTH.size])
            sock.send_unit(memoryview(message)[LENGTH.size :])
            return len(message)
        case _:
            pieces = _flat(messages)
            sock.send_unit(*pieces)
            return sum(map(len, pieces))


def _flat(messages: list[Pieces]) -> list[Bytes]:
    if len(messages) > 1 and all(isinstance(message, bytes) for message in messages):
        return [b"".join(messages)]  # type: ignore[arg-type]  # all are bytes
    flat: list[Bytes] = []
    for message in messages:
        flat += [message] if isinstance(message, bytes) else message
    return flat


def write_data(transport: Any, data: Pieces) -> bool:
    """As `TCPROSTransport.write_data`: for publishers without a queue, and for services.

    Raises:
        ServiceException: a call that a grant does not allow, or over a persistent connection that
            has ended; rospy's own socket raises it when there is no response.
        TransportTerminated: any other connection has ended.
    """
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
    """A service's request or response as it may be sent."""
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
