"""Waiting for changes of the graph: long polling for `rossec.watchGraph`. A shell.

A watcher waits on its own connection, so the master neither connects to it nor queues or retries
anything. Changes in the `BATCH_DELAY` seconds after the first are sent in the same answer: the
launch of a hundred nodes does not take a hundred answers.
"""

import asyncio
import contextlib
from typing import Final

WATCH_WAIT: Final = 5.0  # seconds; an answer without changes shows that the master is alive
BATCH_DELAY: Final = 0.05


class GraphChanges:
    """Notifies all waiting calls of a change of the graph."""

    def __init__(self) -> None:
        self._version = -1
        self._changed: asyncio.Event | None = None  # while a call waits

    def notify(self, version: int | None = None) -> None:
        """The graph has changed, unless its `version` is the one notified before."""
        if version is None or version != self._version:
            self._version = self._version if version is None else version
            if self._changed is not None:
                self._changed.set()
                self._changed = None

    def expect(self) -> asyncio.Event:
        """What the next change from now on sets, to be waited for."""
        if self._changed is None:
            self._changed = asyncio.Event()
        return self._changed

    async def wait(self, longest: float, expected: asyncio.Event | None = None) -> None:
        """Return soon after the next change, or after `longest` seconds.

        `expected`: of `expect`; without it changes count from the first step of this coroutine.
        """
        changed = self.expect() if expected is None else expected
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(longest):
                await changed.wait()
                await asyncio.sleep(BATCH_DELAY)
