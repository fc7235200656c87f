"""Connections to peers' slave APIs, kept for a moment for the program that was told of them.

A shell. A door is opened only if the peer answers; the program that then comes through it finds
the connection made.
"""

import asyncio
from typing import Final

from rossec.net.aio.tasks import TaskSet
from rossec.sidecar.core.endpoints import Endpoint
from rossec.sidecar.executor import SlaveApiClient

_LIFETIME: Final = 5.0


class ConnectionCache:
    """At most one for each peer."""

    def __init__(self) -> None:
        self._clients: dict[Endpoint, SlaveApiClient] = {}
        self._tasks = TaskSet()

    def put(self, remote: Endpoint, client: SlaveApiClient) -> None:
        """Keep a connection for the next caller of `remote`, for a moment."""
        old = self._clients.pop(remote, None)
        self._clients[remote] = client
        self._tasks.spawn(self._close_later(remote, client, old), "a kept connection")

    def take(self, remote: Endpoint) -> SlaveApiClient | None:
        """Such a connection, for this caller alone."""
        return self._clients.pop(remote, None)

    async def close(self) -> None:
        """Let go of all."""
        await self._tasks.close()

    async def _close_later(
        self, remote: Endpoint, client: SlaveApiClient, old: SlaveApiClient | None
    ) -> None:
        if old is not None:
            await old.rpc.close()
        await asyncio.sleep(_LIFETIME)
        if self._clients.get(remote) is client:
            del self._clients[remote]
            await client.rpc.close()
