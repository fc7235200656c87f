"""Waiting for changes of what is registered here: long polling for `rossec.followSite`. A shell.

Only own registrations wake a follower, not imports: else each change in a mesh would be answered by
every master to every other. A new call of a follower ends its one before, which waits with what was
wanted then.
"""

import asyncio
import contextlib

from rossec.master.server.graph_changes import BATCH_DELAY


class SitePolls:
    """The waiting calls, one for each key.

    Args:
        delay: seconds from a change to the answer, which has what changes meanwhile too.
    """

    def __init__(self, delay: float = BATCH_DELAY) -> None:
        self._delay = delay
        self._waiting: dict[bytes, asyncio.Event] = {}
        self._version = -1
        self._changes = 0
        self._answered: dict[bytes, int] = {}  # the changes so far, of those that ask by `missed`

    def __len__(self) -> int:
        return len(self._waiting)

    def notify(self, version: int | None = None) -> None:
        """The registrations have changed, unless their `version` was notified before.

        None: the rights or the lists have changed.
        """
        if version != self._version or version is None:
            self._version = self._version if version is None else version
            self._changes += 1
            for changed in self._waiting.values():
                changed.set()

    def supersede(self, follower: bytes) -> None:
        """A new call of this key has come."""
        before = self._waiting.pop(follower, None)
        if before is not None:
            before.set()

    def missed(self, follower: bytes) -> bool:
        """Whether anything has changed since this was last asked, or since its last wait."""
        before = self._answered.get(follower)
        self._answered[follower] = self._changes
        return before != self._changes

    def expect(self, follower: bytes) -> asyncio.Event:
        """What the next change from now on sets, to be waited for."""
        changed = self._waiting[follower] = asyncio.Event()
        return changed

    async def wait(
        self, follower: bytes, longest: float, expected: asyncio.Event | None = None
    ) -> None:
        """Return soon after the next change, or after `longest` seconds.

        `expected`: of `expect`; without it changes count from the first step of this coroutine.
        """
        changed = self.expect(follower) if expected is None else expected
        try:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(longest):
                    await changed.wait()
                    await asyncio.sleep(self._delay)
        finally:
            if self._waiting.get(follower) is changed:
                del self._waiting[follower]
            if follower in self._answered:
                self._answered[follower] = self._changes
