"""Warnings for the developer: one for each cause, not for each retry.

Lines are limited per ten seconds, and per subject: no peer can suppress the lines about others.
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

REMEMBERED: Final = 512
_BURST: Final = 30  # lines within PERIOD; unauthenticated peers must not fill a disk
_SHARE: Final = 10  # of them about one peer, topic or address
_FIRST: Final = 60  # beyond the burst: only the first line about each subject
_PERIOD: Final = 10.0


class Reporter:
    """Hands each new text to `write`, in a thread of its own."""

    def __init__(self, write: Callable[[str], None]) -> None:
        self._write = write
        self._reported: OrderedDict[str, None] = OrderedDict()
        self._since, self._counts, self._suppressed = 0.0, Counter[str](), False
        self.abandon()
        forget_in_children(self)

    def abandon(self) -> None:
        """In a forked child: the thread is the parent's; a new one is started when needed."""
        self._lock = Lock()
        self._queue: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        self._thread: Thread | None = None

    def warn(self, what: str, why: Exception | None = None) -> None:
        """Log `what`, the error `why` and its hint, unless that line was logged before.

        The subject of the line is the text before the first colon of `what`.
        """
        text = what if why is None else f"{what}: {why}"
        hint = why.hint if isinstance(why, HintedError) else ""
        line = f"rossec: {printable(text)}" + (f" (hint: {printable(hint)})" if hint else "")
        with self._lock:
            if line in self._reported:
                return
            self._reported[line] = None
            if len(self._reported) > REMEMBERED:
                self._reported.popitem(last=False)
            if self._within_limits(what.partition(":")[0]):
                self._put(line)

    def _put(self, line: str) -> None:
        if self._thread is None:
            self._thread = Thread(target=self._run, name="rossec report", daemon=True)
            self._thread.start()
        self._queue.put(line)

    def _within_limits(self, subject: str) -> bool:
        """Whether a line is within the limits; logs once that lines are suppressed."""
        moment = time.monotonic()
        if moment - self._since > _PERIOD:
            self._since, self._counts, self._suppressed = moment, Counter(), False
        most = _BURST if self._counts[subject] else _FIRST
        if self._counts[subject] < _SHARE and self._counts.total() < most:
            self._counts[subject] += 1
            return True
        if not self._suppressed:
            self._put("rossec: too many different warnings; some are suppressed")
        self._suppressed = True
        return False

    def forget(self, what: str) -> None:
        """`what` has succeeded since: if it fails again, it is logged again."""
        with self._lock:
            for line in [line for line in self._reported if line.startswith(f"rossec: {what}")]:
                del self._reported[line]

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
            with suppress(Exception):  # a handler of the program may raise
                self._write(line)


class LogBridge(logging.Handler):
    """Warnings of our own loggers, for which rospy's configuration has only a file."""

    def __init__(self, reporter: Reporter) -> None:
        super().__init__(logging.WARNING)
        self._reporter = reporter

    def emit(self, record: logging.LogRecord) -> None:
        """Log it once."""
        self._reporter.warn(record.getMessage())
