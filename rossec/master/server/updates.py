"""Sending updates to nodes, and waiting for what they poll. A shell.

Stock rosmaster shares three threads between all nodes, so three dead nodes delay all updates
(ros_comm#1555). Here each node has its own task, its own connection and its own deadline. Pending
updates are coalesced: only the newest publisher list of a topic, the newest value of a parameter,
the newest revocation list. So a slow node costs a bounded amount of memory.

Who polls waits on its own connection: the master needs no address of it, and queues nothing; a call
that waited is answered again from the tables.
"""

import asyncio
import contextlib
import logging
from collections import deque
from collections.abc import Awaitable, Callable, Collection, Iterable
from typing import Final

from ca.certificates import Identity
from ca.names import shown
from rossec.errors import AnswerRefused, ConnectionHeaderRefused, RossecError
from rossec.host.runner import TaskSet
from rossec.master.state.parameters import encoded_size
from rossec.master.state.registry import NodeRef
from rossec.net.aio import SecureContext, WireProtocol, connect
from rossec.net.rpc.calls import RpcClient
from rossec.peer_limits import printable
from rossec.ros.names import parse_uri
from rossec.ros.xmlrpc import Fault


def is_node(peer: Identity, node: NodeRef) -> bool:
    named = peer.name == node.name if peer.is_foreign else peer.covers(node.name)
    return named and peer.thumbprint == node.thumbprint


class SlaveDialer:
    """The only place from which the master connects to nodes; `probed` are being probed now.

    Nothing is sent to a peer that is not the node that registered the address: it is reported to
    `on_mismatch`, with the node.
    """

    def __init__(
        self, context: SecureContext[Identity], on_mismatch: Callable[[NodeRef, Identity], None]
    ) -> None:
        self._context = context
        self._on_mismatch = on_mismatch
        self.probed: Final[set[NodeRef]] = set()

    async def dial(self, node: NodeRef) -> RpcClient:
        host, port = parse_uri(node.uri, "the slave API")
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

Dial = Callable[[NodeRef], Awaitable[RpcClient]]
"""Connects to a slave API, or raises `RossecError`, also when another peer answers there."""

OnTaken = Callable[[NodeRef, str, tuple[object, ...]], object]
"""Called with the method and parameters of an update that a node has accepted."""

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
        self._pending: dict[Key, tuple[object, ...]] = {}
        self._encoded_sizes: dict[Key, int] = {}
        self._posted = asyncio.Event()
        self._failures = 0

    @property
    def idle(self) -> bool:
        return not self._pending

    def post(self, key: Key, *params: object) -> None:
        self._pending[key], self._encoded_sizes[key] = params, encoded_size(params)
        while len(self._pending) > 1 and (
            len(self._pending) > PENDING_LIMIT or sum(self._encoded_sizes.values()) > PENDING_BYTES
        ):
            self._discard(next(iter(self._pending)))
        self._posted.set()

    def _discard(self, key: Key) -> None:
        del self._pending[key], self._encoded_sizes[key]

    async def run(self) -> None:
        try:
            while True:
                await self._posted.wait()
                self._posted.clear()
                while self._pending:
                    key, params = next(iter(self._pending.items()))
                    if await self._deliver(key[0], params):
                        self._failures = 0
                        if self._pending.get(key) is params:  # else a newer one was posted meanwhile
                            self._discard(key)
                    elif self._failures >= len(self._retry_after):
                        _log.warning("gave up sending %s to %s", key[0], self.node.name)
                        self._failures = 0
                        self._pending.clear()
                        self._encoded_sizes.clear()
                    else:
                        await asyncio.sleep(self._retry_after[self._failures])
                        self._failures += 1
        finally:
            await self._client.close()

    async def _deliver(self, method: str, params: tuple[object, ...]) -> bool:
        try:
            await self._client.ask(method, *params)
            self._on_taken(self.node, method, params)
        except (Fault, AnswerRefused) as error:
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
        self._closing = TaskSet()

    def post(self, node: NodeRef, key: Key, *params: object) -> None:
        if node not in self._clients:
            if sum(other.thumbprint == node.thumbprint for other in self._clients) >= self._max_clients:
                _log.info("%s changes its address too often: no %s is sent", node.name, key[0])
                return
            client = NodeClient(node, self._dial, on_taken=self._on_taken, deadline=self._deadline)
            tasks = TaskSet()
            tasks.spawn(client.run(), f"updates to {node.name}")
            self._clients[node] = client, tasks
        self._clients[node][0].post(key, *params)

    def prune(self, registered: Collection[NodeRef]) -> None:
        # Disconnect from nodes that are not registered and have no pending update.
        gone = [node for node, (client, _) in self._clients.items() if node not in registered and client.idle]
        for node in gone:
            _, tasks = self._clients.pop(node)
            self._closing.spawn(tasks.close(), f"disconnecting from {node.name}")

    @property
    def nodes(self) -> tuple[NodeRef, ...]:
        return tuple(self._clients)

    def drop(self, node: NodeRef) -> None:
        client = self._clients.pop(node, None)
        if client is not None:
            self._closing.spawn(client[1].close(), f"dropping {node.name}")

    async def close(self) -> None:
        clients, self._clients = self._clients, {}
        await asyncio.gather(*(tasks.close() for _, tasks in clients.values()))
        await self._closing.close()


WAIT: Final = 60.0  # seconds; an answer without grants shows that the master is alive
MAX_WAITING: Final = 64  # calls of one key: the nodes of a wildcard identity


class GrantChanges:
    """The calls that wait for deposited grants, by the key of the caller.

    A new robot, which may register nothing yet, is notified like every other.
    """

    def __init__(self, longest: float = WAIT) -> None:
        self._longest = longest
        self._waiting: dict[bytes, deque[asyncio.Future[None]]] = {}

    def __len__(self) -> int:
        return sum(map(len, self._waiting.values()))

    def notify(self, holders: Iterable[bytes]) -> None:
        for holder in holders:
            for waiting in self._waiting.pop(holder, ()):
                _end(waiting)

    async def wait(self, holder: bytes) -> None:
        # Of too many calls of one key the oldest returns: its connection may be gone.
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
            with contextlib.suppress(ValueError):
                calls.remove(waiting)
            if not calls and self._waiting.get(holder) is calls:
                del self._waiting[holder]


def _end(waiting: asyncio.Future[None]) -> None:
    if not waiting.done():
        waiting.set_result(None)


WATCH_WAIT: Final = 5.0  # seconds; an answer without changes shows that the master is alive
BATCH_DELAY: Final = 0.05


class GraphChanges:
    """The calls that wait for a change of the graph.

    Changes in the `BATCH_DELAY` seconds after the first are sent in the same answer: the launch of a
    hundred nodes does not take a hundred answers.
    """

    def __init__(self) -> None:
        self._version = -1
        self._changed: asyncio.Event | None = None  # while a call waits

    def notify(self, version: int | None = None) -> None:
        # The graph has changed, unless its `version` is the one notified before.
        if version is None or version != self._version:
            self._version = self._version if version is None else version
            if self._changed is not None:
                self._changed.set()
                self._changed = None

    def expect(self) -> asyncio.Event:
        if self._changed is None:
            self._changed = asyncio.Event()
        return self._changed

    async def wait(self, longest: float, expected: asyncio.Event | None = None) -> None:
        # `expected`: of `expect`; without it changes count from the first step of this coroutine.
        changed = self.expect() if expected is None else expected
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(longest):
                await changed.wait()
                await asyncio.sleep(BATCH_DELAY)


class SitePolls:
    """The followers and relays that wait, one call for each key: a new one ends the one before.

    Only own registrations wake a follower, not imports: else each change in a mesh would be answered
    by every master to every other.
    """

    def __init__(self, delay: float = BATCH_DELAY) -> None:
        self._delay = delay  # seconds from a change to the answer, which has what changes meanwhile too
        self._waiting: dict[bytes, asyncio.Event] = {}
        self._version = -1
        self._changes = 0
        self._answered: dict[bytes, int] = {}  # the changes so far, of those that ask by `missed`

    def __len__(self) -> int:
        return len(self._waiting)

    def notify(self, version: int | None = None) -> None:
        # The registrations have changed, unless their `version` was notified before.
        # None: the rights or the lists have changed.
        if version != self._version or version is None:
            self._version = self._version if version is None else version
            self._changes += 1
            for changed in self._waiting.values():
                changed.set()

    def supersede(self, follower: bytes) -> None:
        before = self._waiting.pop(follower, None)
        if before is not None:
            before.set()

    def missed(self, follower: bytes) -> bool:
        # Whether anything has changed since this was last asked, or since its last wait.
        before = self._answered.get(follower)
        self._answered[follower] = self._changes
        return before != self._changes

    def expect(self, follower: bytes) -> asyncio.Event:
        changed = self._waiting[follower] = asyncio.Event()
        return changed

    async def wait(self, follower: bytes, longest: float, expected: asyncio.Event | None = None) -> None:
        # `expected`: of `expect`; without it changes count from the first step of this coroutine.
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
