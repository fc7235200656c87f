"""Sending updates to nodes, and waiting for what they poll. A shell.

Stock rosmaster shares three threads between all nodes, so three dead nodes delay all updates
(ros_comm#1555). Here each node has its own task, its own connection and its own deadline. Pending
updates are coalesced: only the newest publisher list of a topic, the newest value of a parameter,
the newest revocation list. So a slow node costs a bounded amount of memory.
"""

import asyncio
import contextlib
import logging
import sys
from collections import Counter
from collections.abc import Awaitable, Callable, Collection, Iterable
from typing import Final

from ca.bounded import Newest
from ca.certificates import Identity
from ca.names import shown
from rossec.errors import AnswerRefused, ConnectionHeaderRefused, RossecError
from rossec.host.runner import TaskSet
from rossec.master.state.parameters import encoded_size
from rossec.master.state.registry import NodeRef
from rossec.net.aio import SecureContext, WireProtocol, connect
from rossec.net.rpc import RpcClient
from rossec.peer_limits import printable
from rossec.ros import names, xmlrpc


def is_node(peer: Identity, node: NodeRef) -> bool:
    named = peer.name == node.name if peer.is_foreign else peer.covers(node.name)
    return named and peer.thumbprint == node.thumbprint


class SlaveDialer:
    """The only place from which the master connects to nodes; `probed` are being probed now."""

    # Nothing is sent to a peer that is not the node that registered the address: it is reported to
    # `on_mismatch`, with the node.
    def __init__(
        self, context: SecureContext[Identity], on_mismatch: Callable[[NodeRef, Identity], None]
    ) -> None:
        self._context = context
        self._on_mismatch = on_mismatch
        self.probed: Final[set[NodeRef]] = set()

    async def dial(self, node: NodeRef) -> RpcClient:
        host, port = names.parse_uri(node.uri, "the slave API")
        stream = await connect(host, port, self._context, WireProtocol.HTTP)
        if not is_node(stream.peer, node):
            stream.abort("not the node that was registered")
            self._on_mismatch(node, stream.peer)
            other, name = shown(stream.peer.name), shown(node.name)
            raise ConnectionHeaderRefused(f"{other} answers at the slave API of {name}")
        return RpcClient(stream)

    async def probe(self, node: NodeRef) -> None:
        self.probed.add(node)
        try:
            with contextlib.suppress(RossecError, OSError, TimeoutError):
                async with asyncio.timeout(CALL_DEADLINE):
                    await (await self.dial(node)).close()
        finally:
            self.probed.discard(node)


PENDING_LIMIT: Final = 1024
PENDING_BYTES: Final = 8 * 1024 * 1024  # unless one update alone is larger
MAX_CLOSING: Final = 8  # slave APIs of one key that are being sent `shutdown`
CALL_DEADLINE: Final = 5.0  # seconds, for connecting and each call
_RETRY_AFTER: Final = (0.2, 1.0, 3.0)  # seconds; then the update is dropped

_log = logging.getLogger("rossec.master.updates")

# Connects to a slave API, or raises `RossecError`, also when another peer answers there
Dial = Callable[[NodeRef], Awaitable[RpcClient]]
# Called with the method and parameters of an update that a node has accepted
OnTaken = Callable[[NodeRef, str, tuple[object, ...]], object]
Key = tuple[str, str]  # Method and subject: of two pending updates with one key only the newer is sent


class SlaveClient:
    """One connection to a slave API, made when a call needs it."""

    def __init__(self, node: NodeRef, dial: Dial, deadline: float) -> None:
        self._node = node
        self._dial = dial
        self._deadline = deadline
        self._client: RpcClient | None = None

    async def ask(self, method: str, *params: object) -> None:
        async with asyncio.timeout(self._deadline):
            if self._client is None or self._client.closed:
                self._client = await self._dial(self._node)
            await self._client.ask(method, *params)

    async def close(self) -> None:
        client, self._client = self._client, None
        if client is not None:
            with contextlib.suppress(RossecError, OSError, TimeoutError):
                async with asyncio.timeout(self._deadline):
                    await client.close()


class NodeClient:
    def __init__(
        self,
        node: NodeRef,
        dial: Dial,
        *,
        on_taken: OnTaken = lambda _node, _method, _params: None,
        deadline: float = CALL_DEADLINE,
        retry_after: tuple[float, ...] = _RETRY_AFTER,
    ) -> None:
        self.node = node
        self._client = SlaveClient(node, dial, deadline)
        self._on_taken = on_taken
        self._retry_after = retry_after
        self._pending: dict[Key, tuple[tuple[object, ...], int]] = {}  # the parameters and their size
        self._posted = asyncio.Event()
        self._failures = 0

    @property
    def idle(self) -> bool:
        return not self._pending

    def post(self, key: Key, *params: object) -> None:
        self._pending[key] = params, encoded_size(params)
        # A node that does not answer must not fill the memory: the oldest updates are dropped.
        while len(self._pending) > 1 and (
            len(self._pending) > PENDING_LIMIT or sum(s for _, s in self._pending.values()) > PENDING_BYTES
        ):
            del self._pending[next(iter(self._pending))]
        self._posted.set()

    async def run(self) -> None:
        try:
            while True:
                await self._posted.wait()
                self._posted.clear()
                while self._pending:
                    key, update = next(iter(self._pending.items()))
                    if await self._deliver(key[0], update[0]):
                        self._failures = 0
                        if self._pending.get(key) is update:  # else a newer one was posted meanwhile
                            del self._pending[key]
                    elif self._failures >= len(self._retry_after):
                        _log.warning("gave up sending %s to %s", key[0], self.node.name)
                        self._failures = 0
                        self._pending.clear()
                    else:
                        await asyncio.sleep(self._retry_after[self._failures])
                        self._failures += 1
        finally:
            await self._client.close()

    async def _deliver(self, method: str, params: tuple[object, ...]) -> bool:
        try:
            await self._client.ask(method, *params)
            self._on_taken(self.node, method, params)
        except (xmlrpc.Fault, AnswerRefused) as error:
            _log.info("%s answers %s: %s", self.node.name, method, printable(error))
        except (RossecError, OSError, TimeoutError) as error:
            _log.info("cannot reach %s for %s: %s", self.node.name, method, printable(error))
            await self._client.close()
            return False
        return True


class Updates:
    """All node clients. `post` never waits."""

    def __init__(
        self,
        dial: Dial,
        max_clients: int = 64 + MAX_CLOSING,
        *,
        on_taken: OnTaken = lambda _node, _method, _params: None,
        deadline: float = CALL_DEADLINE,
    ) -> None:
        self._on_taken = on_taken
        self._dial = dial
        # clients for one key at a time. A node can register any number of addresses, one after another; the
        # master must neither run out of connections nor be used for a scan
        self._max_clients = max_clients
        self._deadline = deadline
        self._clients: dict[NodeRef, tuple[NodeClient, TaskSet]] = {}
        self._of_key: Counter[bytes] = Counter()  # clients
        self._closing = TaskSet()

    def post(self, node: NodeRef, key: Key, *params: object) -> None:
        if node not in self._clients:
            if self._of_key[node.thumbprint] >= self._max_clients:
                _log.info("%s changes its address too often: no %s is sent", node.name, key[0])
                return
            client = NodeClient(node, self._dial, on_taken=self._on_taken, deadline=self._deadline)
            tasks = TaskSet()
            tasks.spawn(client.run(), f"updates to {node.name}")
            self._clients[node] = client, tasks
            self._of_key[node.thumbprint] += 1
        self._clients[node][0].post(key, *params)

    def prune(self, registered: Collection[NodeRef]) -> None:
        # Disconnect from nodes that are not registered and have no pending update.
        gone = [node for node, (client, _) in self._clients.items() if node not in registered and client.idle]
        for node in gone:
            self._remove(node, f"disconnecting from {node.name}")

    @property
    def nodes(self) -> tuple[NodeRef, ...]:
        return tuple(self._clients)

    def drop(self, node: NodeRef) -> None:
        if node in self._clients:
            self._remove(node, f"dropping {node.name}")

    def _remove(self, node: NodeRef, why: str) -> None:
        _, tasks = self._clients.pop(node)
        self._of_key[node.thumbprint] -= 1
        if not self._of_key[node.thumbprint]:
            del self._of_key[node.thumbprint]
        self._closing.spawn(tasks.close(), why)

    async def close(self) -> None:
        clients, self._clients = self._clients, {}
        await asyncio.gather(*(tasks.close() for _, tasks in clients.values()))
        await self._closing.close()


BATCH_DELAY: Final = 0.05
ANSWERED: Final = 1024  # keys: 64 relays, and whoever was refused; one that is forgotten is answered at once


class LongPolls:
    """The calls that wait for one kind of change, by the key of the caller: the master's one long poll."""

    # Nothing is queued: a call that was woken is answered again from the tables. Changes in the `delay`
    # seconds after the first are in the same answer: the launch of a hundred nodes does not take a hundred
    # answers. Of more than `limit` calls of one key the oldest returns: its connection may be gone.
    def __init__(self, delay: float = BATCH_DELAY, limit: int = sys.maxsize) -> None:
        self._delay = delay
        self._limit = limit
        self._waiting: dict[bytes, list[asyncio.Event]] = {}
        self._version = -1
        self._changes = 0
        self._answered: Newest[bytes, int] = Newest(ANSWERED)  # changes so far, of those that ask by `missed`

    def __len__(self) -> int:
        return sum(map(len, self._waiting.values()))

    def notify(self, version: int | None = None) -> None:
        # Something has changed, unless its `version` is the one notified before.
        if version is None or version != self._version:
            self._version = self._version if version is None else version
            self._changes += 1
            self.wake(tuple(self._waiting))

    def wake(self, keys: Iterable[bytes]) -> None:
        for key in keys:
            for changed in self._waiting.pop(key, ()):
                changed.set()

    def missed(self, key: bytes) -> bool:
        # Whether anything has changed since this was last asked, or since its last wait.
        before = self._answered.get(key)
        self._answered[key] = self._changes
        return before != self._changes

    def expect(self, key: bytes = b"") -> asyncio.Event:
        # For a change from now on: the coroutine of a call begins later, and would miss what comes before.
        changed = asyncio.Event()
        calls = self._waiting.setdefault(key, [])
        calls.append(changed)
        if len(calls) > self._limit:
            calls.pop(0).set()
        return changed

    def forget(self, changed: asyncio.Event, key: bytes = b"") -> None:
        calls = self._waiting.get(key, [])
        if changed in calls:
            calls.remove(changed)
            if not calls:
                del self._waiting[key]

    async def wait(self, longest: float, key: bytes = b"", expected: asyncio.Event | None = None) -> None:
        changed = self.expect(key) if expected is None else expected
        try:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(longest):
                    await changed.wait()
                    await asyncio.sleep(self._delay)
        finally:
            self.forget(changed, key)
            if key in self._answered:
                self._answered[key] = self._changes
