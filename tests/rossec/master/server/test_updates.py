"""Updates to nodes: coalescing, retries, and that none delays another. Slave APIs are in memory."""

import asyncio
from collections.abc import AsyncIterator, Callable
from typing import Any

import pytest

from rossec.errors import PeerUnreachable
from rossec.host.runner import TaskSet
from rossec.master.server.updates import PENDING_BYTES, PENDING_LIMIT, NodeClient, Updates
from rossec.master.state.registry import NodeRef
from rossec.net.rpc.calls import RpcClient, serve_calls
from rossec.ros.xmlrpc import Fault
from tests.support.streams import stream_pair

KEY = ("publisherUpdate", "/t")


class Nodes:
    """Slave APIs that record their calls; the name of a node selects its behaviour."""

    def __init__(self) -> None:
        self.tasks = TaskSet()
        self.calls: list[tuple[str, str, tuple[object, ...]]] = []
        self.dialled: list[str] = []
        self.failures = 0
        self.gate = asyncio.Event()

    async def dial(self, node: NodeRef) -> RpcClient:
        self.dialled.append(node.name)
        if node.name == "/dead":
            await asyncio.sleep(60)
        if self.failures > 0:
            self.failures -= 1
            raise PeerUnreachable("no node there")
        is_local, far = stream_pair("/master", node.name)

        async def dispatch(method: str, params: tuple[object, ...], peer: object) -> object:
            self.calls.append((node.name, method, params))
            if node.name == "/slow":
                await self.gate.wait()
            if node.name == "/hostile":
                raise Fault(1, "no")
            return [1, "", 0]

        self.tasks.spawn(serve_calls(far, dispatch), name=node.name)
        return RpcClient(is_local)

    async def until(self, condition: Callable[[], bool]) -> None:
        async with asyncio.timeout(30):
            while not condition():  # noqa: ASYNC110 - any of many tasks may fulfil it
                await asyncio.sleep(0.001)

    def received_calls(self, name: str) -> list[Any]:
        return [params for who, _, params in self.calls if who == name]


@pytest.fixture
async def nodes() -> AsyncIterator[Nodes]:
    nodes = Nodes()
    yield nodes
    await nodes.tasks.close()


@pytest.fixture
async def updates(nodes: Nodes) -> AsyncIterator[Updates]:
    updates = Updates(nodes.dial)
    yield updates
    await updates.close()


def ref(name: str) -> NodeRef:
    return NodeRef(name, f"http://{name[1:]}:1/", name.encode())


async def test_dead_nodes_do_not_delay_a_live_one(nodes: Nodes, updates: Updates) -> None:
    for port in range(3):
        updates.post(NodeRef("/dead", f"http://dead:{port}/", b"/dead"), KEY, "first")
    updates.post(ref("/slow"), KEY, "first")
    for n in range(3):
        updates.post(ref("/live"), (KEY[0], f"/t{n}"), n)
    await nodes.until(lambda: nodes.received_calls("/live") == [(0,), (1,), (2,)])
    assert nodes.dialled.count("/dead") == 3
    assert nodes.dialled.count("/live") == 1


async def test_only_the_newest_update_is_sent(nodes: Nodes, updates: Updates) -> None:
    updates.post(ref("/slow"), KEY, 1)
    await nodes.until(lambda: nodes.received_calls("/slow") == [(1,)])
    for n in range(2, 10):
        updates.post(ref("/slow"), KEY, n)
    nodes.gate.set()
    await nodes.until(lambda: len(nodes.received_calls("/slow")) == 2)
    assert nodes.received_calls("/slow") == [(1,), (9,)]


async def test_an_update_posted_twice_is_sent_twice(nodes: Nodes, updates: Updates) -> None:
    """The second must be sent even if equal: another may have come between."""
    updates.post(ref("/live"), KEY, 1)
    await nodes.until(lambda: len(nodes.received_calls("/live")) == 1)
    updates.post(ref("/live"), KEY, 1)
    await nodes.until(lambda: len(nodes.received_calls("/live")) == 2)


async def run(client: NodeClient, nodes: Nodes, condition: Callable[[], bool]) -> None:
    tasks = TaskSet()
    tasks.spawn(client.run())
    await nodes.until(condition)
    await tasks.close()


async def test_a_node_that_starts_late_receives_the_update(nodes: Nodes) -> None:
    nodes.failures = 2
    client = NodeClient(ref("/live"), nodes.dial, retry_after=(0.0, 0.0))
    client.post(KEY, 1)
    await run(client, nodes, lambda: nodes.received_calls("/live") == [(1,)])
    assert nodes.dialled == ["/live"] * 3


async def test_an_unreachable_node_is_given_up(nodes: Nodes, caplog: pytest.LogCaptureFixture) -> None:
    nodes.failures = 3
    client = NodeClient(ref("/live"), nodes.dial, retry_after=(0.0, 0.0))
    client.post(KEY, 1)
    await run(client, nodes, lambda: client.idle)
    assert nodes.received_calls("/live") == []
    assert "gave up sending" in caplog.text


async def test_a_deadline_ends_each_attempt(nodes: Nodes) -> None:
    client = NodeClient(ref("/slow"), nodes.dial, deadline=0.01, retry_after=(0.0,))
    client.post(KEY, 1)
    await run(client, nodes, lambda: client.idle)
    assert nodes.dialled == ["/slow", "/slow"]


async def test_a_refused_update_is_delivered(nodes: Nodes, updates: Updates) -> None:
    updates.post(ref("/hostile"), KEY, 1)
    updates.post(ref("/hostile"), ("paramUpdate", "/k"), 2)
    await nodes.until(lambda: nodes.received_calls("/hostile") == [(1,), (2,)])
    assert nodes.dialled == ["/hostile"]


def test_pending_updates_are_limited_in_number(nodes: Nodes) -> None:
    client = NodeClient(ref("/dead"), nodes.dial)
    for n in range(PENDING_LIMIT + 5):
        client.post(("paramUpdate", f"/k{n}"), n)
    assert len(client._pending) == PENDING_LIMIT
    assert ("paramUpdate", "/k0") not in client._pending


def test_pending_updates_are_limited_in_size(nodes: Nodes) -> None:
    client = NodeClient(ref("/slow"), nodes.dial)
    big = "x" * (PENDING_BYTES // 4)
    for number in range(6):
        client.post(("paramUpdate", f"/{number}"), big)
    assert [key for _, key in client._pending] == ["/3", "/4", "/5"]
    client.post(("paramUpdate", "/all"), big * 5)
    assert [key for _, key in client._pending] == ["/all"]
    client.post(("paramUpdate", "/all"), 1)
    client.post(("paramUpdate", "/0"), big)
    assert len(client._pending) == 2


async def test_the_clients_of_a_key_are_limited(nodes: Nodes) -> None:
    updates = Updates(nodes.dial, 3)
    for number in range(9):
        updates.post(NodeRef("/dead", f"http://h:{number}/", b"one key"), KEY, number)
    other = NodeRef("/live", "http://h:1/", b"another key")
    updates.post(other, KEY, 1)
    await nodes.until(lambda: nodes.received_calls("/live") == [(1,)])
    assert nodes.dialled.count("/dead") == 3
    updates.drop(updates.nodes[0])
    updates.post(NodeRef("/dead", "http://h:9/", b"one key"), KEY, 9)
    await nodes.until(lambda: nodes.dialled.count("/dead") == 4)
    for node in updates.nodes:
        updates.drop(node)
        updates.drop(node)
    assert not updates._of_key, "who has gone leaves nothing"
    await updates.close()


async def test_unregistered_nodes_are_disconnected_after_their_updates(
    nodes: Nodes, updates: Updates
) -> None:
    updates.post(ref("/live"), KEY, 1)
    updates.post(ref("/slow"), KEY, 1)
    await nodes.until(lambda: len(nodes.calls) == 2)
    updates.prune({ref("/live")})
    assert set(updates._clients) == {ref("/live"), ref("/slow")}
    nodes.gate.set()
    await nodes.until(lambda: all(c.idle for c, _ in updates._clients.values()))
    updates.prune({ref("/live")})
    assert set(updates._clients) == {ref("/live")}
    assert updates.nodes == (ref("/live"),)


async def test_a_dropped_node_receives_no_more_updates(nodes: Nodes, updates: Updates) -> None:
    for name in ("/slow", "/live"):
        updates.post(ref(name), KEY, 1)
        updates.post(ref(name), ("paramUpdate", "/k"), 2)
    await nodes.until(lambda: len(nodes.calls) == 3)
    other = ref("/slow")._replace(thumbprint=b"another key")
    updates.drop(other)
    assert ref("/slow") in updates.nodes
    updates.drop(ref("/slow"))
    assert updates.nodes == (ref("/live"),)
    await nodes.until(lambda: len(updates._closing) == 0)
    nodes.gate.set()
    assert nodes.received_calls("/slow") == [(1,)]


async def test_what_a_node_has_accepted_is_reported(nodes: Nodes) -> None:
    taken: list[tuple[str, str, object]] = []
    updates = Updates(
        nodes.dial, on_taken=lambda node, method, params: taken.append((node.name, method, params))
    )
    for name in ("/hostile", "/a"):
        updates.post(NodeRef(name, "http://h:1/", b"k"), KEY, "/master", "/t")
    await nodes.until(lambda: len(nodes.calls) == 2 and bool(taken))
    await updates.close()
    assert taken == [("/a", "publisherUpdate", ("/master", "/t"))]
