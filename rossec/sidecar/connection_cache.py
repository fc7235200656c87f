"""Connections to peers' slave APIs, kept for a moment for the program that was told of them.

A shell. A door is opened only if the peer answers; the program that then comes through it finds
the connection made.
"""

import asyncio
from typing import Final

from rossec.net.aio.tasks import TaskSet
from rossec.sidecar.core.endpoints import Endpoint
from rossec.sidecar.executor import SlaveApiClient

_KEEP: Final = 5.0


class ConnectionCache:
    """At most one for each peer."""

    def __init__(self) -> None:
        self._kept: dict[Endpoint, SlaveApiClient] = {}
        self._tasks = TaskSet()

    def keep(self, remote: Endpoint, correspondent: SlaveApiClient) -> None:
        """Keep a connection for the next caller of `remote`, for a moment."""
        old = self._kept.pop(remote, None)
        self._kept[remote] = correspondent
        self._tasks.spawn(self._let_go(remote, correspondent, old), "a kept connection")

    def take(self, remote: Endpoint) -> SlaveApiClient | None:
        """Such a connection, for this caller alone."""
        return self._kept.pop(remote, None)

    async def close(self) -> None:
        """Let go of all."""
        await self._tasks.close()

    async def _let_go(
        self, remote: Endpoint, correspondent: SlaveApiClient, old: SlaveApiClient | None
    ) -> None:
        if old is not None:
            await old.client.close()
        await asyncio.sleep(_KEEP)
        if self._kept.get(remote) is correspondent:
            del self._kept[remote]
            await correspondent.client.close()
