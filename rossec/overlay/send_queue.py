"""Messages on their way to the session: at once, unless that would stop the loop.

A put takes microseconds, until the uplink is full: then Zenoh waits 50 ms for room before it drops
the message, and everything else in the process would wait too. From the first put that was slow, a
thread puts, until it has nothing left and was quick for a second. What finds no room in its queue
is dropped, as Zenoh would.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from threading import Lock
from time import monotonic
from typing import Final

SLOW: Final = 0.02  # seconds
CALM: Final = 1.0
MOST_WAITING: Final = 4 * 1024 * 1024  # bytes, as one link may have on the way


class SendQueue:
    """The way of messages to `send`, which may take long; no message overtakes another."""

    def __init__(self, send: Callable[[str, bytes], None]) -> None:
        self._send = send
        self._thread: ThreadPoolExecutor | None = None
        self._lock = Lock()
        self._waiting = 0
        self._slow_until = 0.0
        self._closed = False

    def put(self, key: str, data: bytes) -> None:
        """Send, now or soon; or drop it."""
        if self._waiting == 0 and monotonic() >= self._slow_until:
            self._send_timed(key, data)
        elif self._waiting + len(data) <= MOST_WAITING and not self._closed:
            if self._thread is None:
                self._thread = ThreadPoolExecutor(1, "rossec-overlay")
            with self._lock:
                self._waiting += len(data)
            self._thread.submit(self._send_queued, key, data)

    def _send_timed(self, key: str, data: bytes) -> None:
        began = monotonic()
        self._send(key, data)
        ended = monotonic()
        if ended - began > SLOW:
            self._slow_until = ended + CALM

    def _send_queued(self, key: str, data: bytes) -> None:
        try:
            self._send_timed(key, data)
        finally:
            with self._lock:
                self._waiting -= len(data)

    def close(self) -> None:
        """Drop what waits."""
        self._closed = True
        if self._thread is not None:
            self._thread.shutdown(wait=False, cancel_futures=True)
