"""A query for what was not wanted before waits until the other masters have answered. A shell.

Facts travel by need, so the first query for a name would be answered with no although a site has
it. It waits for the sites that are connected, and not long: a site that is slow delays nobody more
than once in a minute, the time for which the name is wanted then.
"""

import asyncio
import contextlib
from typing import Final

from rossec.master.state.imports import Imports

SITES_WAIT: Final = 1.0  # seconds
ASKING: Final = frozenset(
    {"lookupService", "lookupNode", "getSystemState", "getPublishedTopics", "getTopicTypes"}
)
"""The calls that wait; a subscriber is told of publishers later."""


class SiteAnswers:
    """The waiting queries."""

    def __init__(self, imports: Imports) -> None:
        self._imports = imports
        self._settled: asyncio.Event | None = None  # while a query waits
        imports.on_settled = self._wake

    async def wait(self, longest: float = SITES_WAIT) -> None:
        """Return when every connected site has answered what is wanted, or after `longest`."""
        if self._imports.is_settled:
            return
        if self._settled is None:
            self._settled = asyncio.Event()
        settled = self._settled
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(longest):
                await settled.wait()

    def _wake(self) -> None:
        if self._settled is not None:
            self._settled.set()
            self._settled = None
