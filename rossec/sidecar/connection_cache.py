"""Connections to peers' slave APIs, cached briefly for the program that looked them up.

A shell. A port is opened only if the peer answers; the program that then connects to the port
reuses that connection.
"""

import asyncio
from typing import Final

from rossec.net.aio.tasks import TaskSet
from rossec.sidecar.core.endpoints import Endpoint
from rossec.sidecar.executor import SlaveApiClient

LIFETIME: Final = 5.0


class ConnectionCache:
    """Caches at most one connection for each peer."""

    def __init__(self) -> None:
        self._clients: dict[Endpoint, SlaveApiClient] = {}
        self._tasks = TaskSet()

    def put(self, remote: Endpoint, client: SlaveApiClient) -> None:
        """Cache a connection for the next caller of `remote`, for a few seconds."""
        old = self._clients.pop(remote, None)
        self._clients[remote] = client
        self._tasks.spawn(self._close_later(remote, client, old), "a cached connection")

    def take(self, remote: Endpoint) -> SlaveApiClient | None:
        """Take a cached connection to `remote`."""
        return self._clients.pop(remote, None)

    async def close(self) -> None:
        """Drop all connections."""
        await self._tasks.close()

    async def _close_later(
        self, remote: Endpoint, client: SlaveApiClient, old: SlaveApiClient | None
    ) -> None:
        if old is not None:
            await old.rpc.close()
        await asyncio.sleep(LIFETIME)
        if self._clients.get(remote) is client:
            del self._clients[remote]
            await client.rpc.close()
