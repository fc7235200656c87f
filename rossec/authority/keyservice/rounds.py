"""What the service does again and again: every minute, and at once when there is a reason. A shell.

A reason is a key that was unlocked, or something recorded that waits for the key or the master. One
that comes during a round begins another. A task that crashes keeps no other from being done.
"""

import asyncio
import logging
from collections.abc import Awaitable, Callable
from typing import Final

ROUND: Final = 60.0  # seconds between two rounds
_log = logging.getLogger("rossec.authority.service")

Task = Callable[[], None]


class Rounds:
    """Calls its tasks, one after the other.

    Args:
        in_thread: calls a task in a thread.
    """

    def __init__(self, in_thread: Callable[[Task], Awaitable[None]]) -> None:
        self._in_thread = in_thread
        self._tasks: list[Task] = []
        self._due = asyncio.Event()
        self._loop: asyncio.AbstractEventLoop | None = None

    def add(self, task: Task, *, first: bool = False) -> None:
        """Call `task` in every round, as the last or `first` one."""
        self._tasks.insert(0 if first else len(self._tasks), task)

    def wake(self) -> None:
        """Begin a round now; for every thread."""
        if self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._due.set)

    async def run(self) -> None:
        """Do rounds until this is cancelled."""
        self._loop = asyncio.get_running_loop()
        while True:
            self._due.clear()
            for task in self._tasks:
                try:
                    await self._in_thread(task)
                except Exception:  # noqa: BLE001 - without the next, revocations would stay behind
                    _log.exception("a round of the authority failed")
            try:
                async with asyncio.timeout(ROUND):
                    await self._due.wait()
            except TimeoutError:
                continue
