"""What the developer is told: one warning for each cause, not for each retry.

Lines are few in ten seconds, and few of those about one: nobody silences what is said of others.
Written by a thread of its own: `rospy.logwarn` publishes on /rosout and asks the master for a
parameter, so it must never be called by the thread that speaks to the master, nor with a lock held.
"""

import logging
import queue
import time
from collections import Counter, OrderedDict
from collections.abc import Callable
from contextlib import suppress
from threading import Lock, Thread
from typing import Final

from ca.errors import HintedError
from rossec.net.forks import forget_in_children
from rossec.ros.text import printable

_REMEMBERED: Final = 512
_BURST: Final = 30  # lines within PERIOD; strangers must not be able to fill a disk
_SHARE: Final = 10  # of them about one peer, topic or address
_FIRST: Final = 60  # beyond the burst, the first line about each
_PERIOD: Final = 10.0


class Reporter:
    """Hands each new text to `write`, in a thread of its own."""

    def __init__(self, write: Callable[[str], None]) -> None:
        self._write = write
        self._said: OrderedDict[str, None] = OrderedDict()
        self._since, self._about, self._left_out = 0.0, Counter[str](), False
        self.abandon()
        forget_in_children(self)

    def abandon(self) -> None:
        """In a forked child: the thread is the parent's; another is started when it is needed."""
        self._lock = Lock()
        self._queue: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        self._thread: Thread | None = None

    def warn(self, what: str, why: Exception | None = None) -> None:
        """Say `what`, because of `why`, with its hint, unless it was said before.

        What it is about stands before the first colon of `what`.
        """
        text = what if why is None else f"{what}: {why}"
        hint = why.hint if isinstance(why, HintedError) else ""
        line = f"rossec: {printable(text)}" + (f" (hint: {printable(hint)})" if hint else "")
        with self._lock:
            if line in self._said:
                return
            self._said[line] = None
            if len(self._said) > _REMEMBERED:
                self._said.popitem(last=False)
            if self._has_room(what.partition(":")[0]):
                self._put(line)

    def _put(self, line: str) -> None:
        if self._thread is None:
            self._thread = Thread(target=self._run, name="rossec report", daemon=True)
            self._thread.start()
        self._queue.put(line)

    def _has_room(self, about: str) -> bool:
        """Whether one more line is no flood; the first that is too many says so."""
        moment = time.monotonic()
        if moment - self._since > _PERIOD:
            self._since, self._about, self._left_out = moment, Counter(), False
        most = _BURST if self._about[about] else _FIRST
        if self._about[about] < _SHARE and self._about.total() < most:
            self._about[about] += 1
            return True
        if not self._left_out:
            self._put("rossec: more different warnings than are written; some are left out")
        self._left_out = True
        return False

    def forget(self, what: str) -> None:
        """`what` has gone well since: if it fails again, that is news."""
        with self._lock:
            for line in [line for line in self._said if line.startswith(f"rossec: {what}")]:
                del self._said[line]

    def close(self) -> None:
        """Write what is queued, then stop."""
        with self._lock:
            thread, self._thread = self._thread, None
        if thread is not None:
            self._queue.put(None)
            thread.join(timeout=1.0)

    def _run(self) -> None:
        lines = self._queue
        while (line := lines.get()) is not None:
            with suppress(Exception):  # whatever a handler of the program's does, the next is said
                self._write(line)


class LogBridge(logging.Handler):
    """Warnings of our own loggers, for which rospy's configuration has only a file."""

    def __init__(self, reporter: Reporter) -> None:
        super().__init__(logging.WARNING)
        self._reporter = reporter

    def emit(self, record: logging.LogRecord) -> None:
        """Say it once."""
        self._reporter.warn(record.getMessage())
