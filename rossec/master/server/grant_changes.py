"""Waiting for deposited grants: long polling for `rossec.watchGrants`. A shell.

A node waits on a connection of its own, so the master needs no address of it: a new robot, which
may register nothing yet, is notified like every other. Nothing is queued here; a call that waited
is answered again from the table.
"""

import asyncio
import contextlib
from collections import deque
from collections.abc import Iterable
from typing import Final

WAIT: Final = 60.0  # seconds; an answer without grants shows that the master is alive
MAX_WAITING: Final = 64  # calls of one key: the nodes of a wildcard identity


class GrantChanges:
    """The waiting calls, by the key of the caller.

    Args:
        longest: seconds until a call is answered without a grant.
    """

    def __init__(self, longest: float = WAIT) -> None:
        self._longest = longest
        self._waiting: dict[bytes, deque[asyncio.Future[None]]] = {}

    def __len__(self) -> int:
        return sum(map(len, self._waiting.values()))

    def notify(self, holders: Iterable[bytes]) -> None:
        """There are new grants for these keys."""
        for holder in holders:
            for waiting in self._waiting.pop(holder, ()):
                _end(waiting)

    async def wait(self, holder: bytes) -> None:
        """Return after the next grant for `holder`, or after `longest` seconds.

        Of too many calls of one key the oldest returns: its connection may be gone.
        """
        waiting = asyncio.get_running_loop().create_future()
        calls = self._waiting.setdefault(holder, deque())
        calls.append(waiting)
        if len(calls) > MAX_WAITING:
            _end(calls.popleft())
        try:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(self._longest):
                    await waiting
        finally:
            self._discard(holder, waiting)

    def _discard(self, holder: bytes, waiting: asyncio.Future[None]) -> None:
        calls = self._waiting.get(holder)
        if calls is not None:
            with contextlib.suppress(ValueError):
                calls.remove(waiting)
            if not calls:
                del self._waiting[holder]


def _end(waiting: asyncio.Future[None]) -> None:
    if not waiting.done():
        waiting.set_result(None)
