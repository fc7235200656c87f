"""Waiting until the graph changes: what lets a call for news be answered when there are some.

A shell. A watcher waits on its own connection, so nobody is called, queued for or retried; whatever
happens in `BATCH_DELAY` seconds after a change is told with it, so that a launch of a hundred nodes is
not told in a hundred answers.
"""

import asyncio
import contextlib
from typing import Final

WATCH_WAIT: Final = 5.0  # seconds; an answer without news tells the watcher that all is well
BATCH_DELAY: Final = 0.05


class GraphChanges:
    """Wakes whoever waits when the state of the graph has changed."""

    def __init__(self) -> None:
        self._version = -1
        self._changed: asyncio.Event | None = None  # while somebody waits

    def notify(self, version: int | None = None) -> None:
        """There is news, unless the state still has the `version` told before."""
        if version is None or version != self._version:
            self._version = self._version if version is None else version
            if self._changed is not None:
                self._changed.set()
                self._changed = None

    async def wait(self, longest: float) -> None:
        """Return soon after the next change, or after `longest` seconds."""
        if self._changed is None:
            self._changed = asyncio.Event()
        changed = self._changed
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(longest):
                await changed.wait()
                await asyncio.sleep(BATCH_DELAY)
