"""Sending updates to nodes: one client per slave API, none of which can delay another.

Stock rosmaster shares three threads between all nodes, so three dead nodes delay all updates
(ros_comm#1555). Here each node has its own task, its own connection and its own deadline. Pending
updates are coalesced: only the newest publisher list of a topic, the newest value of a parameter,
the newest revocation list. So a slow node costs a bounded amount of memory.
"""

import asyncio
import contextlib
import logging
from collections.abc import Awaitable, Callable, Collection
from typing import Final

from rossec.errors import AnswerRefused, RossecError
from rossec.master.state.parameter_values import encoded_size
from rossec.master.state.registry import NodeRef
from rossec.net.aio.tasks import TaskSet
from rossec.net.rpc.client import RpcClient
from rossec.ros.text import printable
from rossec.ros.xmlrpc import Fault

PENDING_LIMIT: Final = 1024
PENDING_BYTES: Final = 8 * 1024 * 1024  # unless one update alone is larger
MAX_CLOSING: Final = 8  # slave APIs of one key that are being sent `shutdown`
CALL_DEADLINE: Final = 5.0  # seconds, for connecting and each call
_RETRY_AFTER: Final = (0.2, 1.0, 3.0)  # seconds; then the update is dropped

_log = logging.getLogger("rossec.master.updates")

Dial = Callable[[NodeRef], Awaitable[RpcClient]]
"""Connects to a slave API, or raises `RossecError`, also when another peer answers there."""

OnTaken = Callable[[NodeRef, str, tuple[object, ...]], None]
"""Called with the method and parameters of an update that a node has accepted."""

Key = tuple[str, str]
"""Method and subject: of two pending updates with one key only the newer is sent."""


def ignore_taken(node: NodeRef, method: str, params: tuple[object, ...]) -> None:
    """Take no notice."""


class NodeClient:
    """Delivers updates to one slave API, in order, the newest of each kind."""

    def __init__(
        self,
        node: NodeRef,
        dial: Dial,
        *,
        on_taken: OnTaken = ignore_taken,
        deadline: float = CALL_DEADLINE,
        retry_after: tuple[float, ...] = _RETRY_AFTER,
    ) -> None:
        self.node = node
        self._dial = dial
        self._on_taken = on_taken
        self._deadline = deadline
        self._retry_after = retry_after
        self._pending: dict[Key, tuple[object, ...]] = {}
        self._encoded_sizes: dict[Key, int] = {}
        self._posted = asyncio.Event()
        self._client: RpcClient | None = None
        self._failures = 0

    @property
    def idle(self) -> bool:
        """No update is pending."""
        return not self._pending

    def post(self, key: Key, *params: object) -> None:
        """Send `key[0](*params)` soon, in place of a pending update with the same key."""
        self._pending[key], self._encoded_sizes[key] = params, encoded_size(params)
        while len(self._pending) > PENDING_LIMIT or self._is_oversized():
            self._discard(next(iter(self._pending)))
        self._posted.set()

    def _is_oversized(self) -> bool:
        return len(self._pending) > 1 and sum(self._encoded_sizes.values()) > PENDING_BYTES

    def _discard(self, key: Key) -> None:
        del self._pending[key], self._encoded_sizes[key]

    async def run(self) -> None:
        """Deliver until cancelled."""
        try:
            while True:
                await self._posted.wait()
                self._posted.clear()
                await self._deliver_all()
        finally:
            await self._disconnect()

    async def _deliver_all(self) -> None:
        while self._pending:
            key, params = next(iter(self._pending.items()))
            if await self._deliver(key[0], params):
                self._failures = 0
                self._sent(key, params)
            elif self._failures >= len(self._retry_after):
                _log.warning("gave up sending %s to %s", key[0], self.node.name)
                self._failures = 0
                self._pending.clear()
                self._encoded_sizes.clear()
            else:
                await asyncio.sleep(self._retry_after[self._failures])
                self._failures += 1

    def _sent(self, key: Key, params: tuple[object, ...]) -> None:
        if self._pending.get(key) is params:  # else a newer one was posted meanwhile
            self._discard(key)

    async def _deliver(self, method: str, params: tuple[object, ...]) -> bool:
        """Whether the update was delivered, whatever the node answers."""
        try:
            async with asyncio.timeout(self._deadline):
                if self._client is None or self._client.closed:
                    self._client = await self._dial(self.node)
                await self._client.ask(method, *params)
            self._on_taken(self.node, method, params)
        except (Fault, AnswerRefused) as error:
            _log.info("%s answers %s: %s", self.node.name, method, printable(error))
        except (RossecError, OSError, TimeoutError) as error:
            _log.info("cannot reach %s for %s: %s", self.node.name, method, printable(error))
            await self._disconnect()
            return False
        return True

    async def _disconnect(self) -> None:
        client, self._client = self._client, None
        if client is not None:
            with contextlib.suppress(RossecError, OSError, TimeoutError):
                async with asyncio.timeout(self._deadline):
                    await client.close()


class Updates:
    """All node clients. `post` never waits.

    Args:
        max_clients: clients for one key at a time. A node can register any number of addresses, one
            after another; the master must neither run out of connections nor be used for a scan.
        on_taken: called for each update that a node has accepted.
    """

    def __init__(
        self,
        dial: Dial,
        max_clients: int = 64 + MAX_CLOSING,
        *,
        on_taken: OnTaken = ignore_taken,
        deadline: float = CALL_DEADLINE,
    ) -> None:
        self._on_taken = on_taken
        self._dial = dial
        self._max_clients = max_clients
        self._deadline = deadline
        self._clients: dict[NodeRef, tuple[NodeClient, TaskSet]] = {}
        self._closing = TaskSet()

    def post(self, node: NodeRef, key: Key, *params: object) -> None:
        """Send an update to `node`, unless its key has too many clients."""
        if node not in self._clients:
            if (
                sum(other.thumbprint == node.thumbprint for other in self._clients)
                >= self._max_clients
            ):
                _log.info("%s changes its address too often: no %s is sent", node.name, key[0])
                return
            client = NodeClient(node, self._dial, on_taken=self._on_taken, deadline=self._deadline)
            tasks = TaskSet()
            tasks.spawn(client.run(), f"updates to {node.name}")
            self._clients[node] = client, tasks
        self._clients[node][0].post(key, *params)

    def prune(self, registered: Collection[NodeRef]) -> None:
        """Disconnect from nodes that are not registered and have no pending update."""
        gone = [
            node
            for node, (client, _) in self._clients.items()
            if node not in registered and client.idle
        ]
        for node in gone:
            _, tasks = self._clients.pop(node)
            self._closing.spawn(tasks.close(), f"disconnecting from {node.name}")

    @property
    def nodes(self) -> tuple[NodeRef, ...]:
        """The nodes that have a client, registered or not."""
        return tuple(self._clients)

    def drop(self, node: NodeRef) -> None:
        """Disconnect now, with updates pending (the key is revoked, or the address another's)."""
        client = self._clients.pop(node, None)
        if client is not None:
            self._closing.spawn(client[1].close(), f"dropping {node.name}")

    async def close(self) -> None:
        """Stop all clients."""
        clients, self._clients = self._clients, {}
        await asyncio.gather(*(tasks.close() for _, tasks in clients.values()))
        await self._closing.close()
