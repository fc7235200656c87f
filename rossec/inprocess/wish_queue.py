"""Sending to a subscriber with wishes: thinned out, the newest only, deflated.

What comes here has passed the guard. The sending thread takes a message when those before it are
with the kernel, which takes no more than it can send soon; only then the message is deflated.
Without a queue (`queue_size=None`) a publisher waits for each subscriber: no wish is taken then.
"""

import socket
import time
from collections import deque
from collections.abc import Sequence
from typing import Any, Final

from rossec.channel.records import Bytes
from rossec.inprocess.send_queue import LENGTH, Pieces, SendQueue, write
from rossec.net.bounds import UNSENT
from rossec.participant.deflating import Deflatable, SharedDeflation
from rossec.participant.wished_rate import WishedRate
from rossec.participant.wishes import Wishes

_deflation: Final = SharedDeflation()  # publishing calls the queues of one message in a row


def queue_for(connection: Any, queue_size: int) -> SendQueue:
    """The queue of an admitted subscriber, in place of rospy's `QueuedConnection`."""
    wishes: Wishes = connection.socket.wishes
    if wishes:
        return WishQueue(connection, queue_size, wishes)
    return SendQueue(connection, queue_size)


class WishQueue(SendQueue):
    """As `SendQueue`, for a subscriber with `wishes`."""

    def __init__(self, connection: Any, queue_size: int, wishes: Wishes) -> None:
        size = 1 if wishes.newest else queue_size
        self._waiting: deque[Deflatable] = deque(maxlen=size if size > 0 else None)
        self._wishes = wishes
        self._rate = None if wishes.rate is None else WishedRate(wishes.rate)
        if wishes.newest:
            connection.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, UNSENT)
        super().__init__(connection, 1)

    def write_data(self, data: Pieces) -> bool:
        """Queue a message, unless the rate takes it away.

        Raises:
            Exception: what an earlier one failed with.
        """
        if self._error is not None:
            error, self._error = self._error, None
            raise error
        if self._rate is not None and not self._rate.admits(time.monotonic()):
            return True
        self._waiting.append(_deflation.of(_content(data), data))
        self._queue.append(())  # there is something: the thread looks here, and takes from there
        if self._idle:
            with self._filled:
                self._idle = False
                self._filled.notify()
        time.sleep(0)  # as rospy: lets the sending thread run
        return True

    def _send_waiting(self) -> None:
        self._queue.clear()
        while self._waiting:  # nobody else takes from it
            write(self._connection, [self._framed(self._waiting.popleft())])

    def _framed(self, message: Deflatable) -> Pieces:
        if not self._wishes.deflate:
            return LENGTH.pack(sum(map(len, message.pieces))), *message.pieces
        content = message.content()
        return LENGTH.pack(len(content)), content


def _content(data: Pieces) -> Sequence[Bytes]:
    """A message without its length."""
    return (memoryview(data)[LENGTH.size :],) if isinstance(data, bytes) else data[1:]
