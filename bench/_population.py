"""Idle nodes: registered, connected, with a slave API, in a process of their own."""

import asyncio
import contextlib
import multiprocessing
import queue
import resource
import time
from collections.abc import Iterator, Sequence
from multiprocessing.queues import Queue

from bench._lines import Line, request
from bench._masters import EnrolledNode
from ca.certificates import Identity, TrustAnchor
from rossec.errors import RossecError
from rossec.net.aio import SecureContext, SecureStream, WireProtocol, connect, serve
from rossec.net.rpc import RpcClient, serve_calls

TYPE = "std_msgs/String"
_ATTEMPTS = 10
_WITHIN = 300  # seconds until all have come


async def _answer(method: str, params: tuple[object, ...], peer: Identity) -> object:  # noqa: ARG001
    return [1, "", 0]


async def _slave(stream: SecureStream[Identity]) -> None:
    await serve_calls(stream, _answer)


async def join(member: EnrolledNode, port: int, anchor: TrustAnchor) -> RpcClient:
    """One node: a control connection that stays, a slave API, three registrations, a parameter."""
    slave = serve(_slave, "127.0.0.1", 0, SecureContext(member.credentials, anchor.verify), WireProtocol.HTTP)
    uri = f"http://127.0.0.1:{slave.port}/"
    for _ in range(_ATTEMPTS):  # as nodes do: a machine that is busy with others may be too slow
        with contextlib.suppress(RossecError):
            return await _register(member, uri, port, anchor)
    raise RuntimeError(f"{member.name} could not register")


async def _register(member: EnrolledNode, uri: str, port: int, anchor: TrustAnchor) -> RpcClient:
    stream = await connect(
        "127.0.0.1", port, SecureContext(member.credentials, anchor.verify), WireProtocol.HTTP
    )
    client = RpcClient(stream, deadline=60)
    await client.ask("rossec.presentGrants", member.name, [member.grant])
    for method, *params in registrations(member.name, uri):
        await client.ask(str(method), member.name, *params)
    return client


def registrations(name: str, uri: str) -> list[tuple[object, ...]]:
    """What every node registers: method and parameters after the caller's name."""
    return [
        ("registerPublisher", f"{name}/pose", TYPE, uri),
        ("registerSubscriber", f"{name}/goal", TYPE, uri),
        ("registerService", f"{name}/reset", f"rosrpc://127.0.0.1:{uri[17:-1]}", uri),
        ("setParam", f"{name}/rate", 10),
    ]


def _nodes(members: Sequence[EnrolledNode], port: int, anchor: bytes, ready: "Queue[int]") -> None:
    limit = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    resource.setrlimit(resource.RLIMIT_NOFILE, (limit, limit))

    async def main() -> None:
        trust, turn = TrustAnchor.load(anchor), asyncio.Semaphore(8)

        async def one(member: EnrolledNode) -> RpcClient:
            async with turn:
                return await join(member, port, trust)

        clients = await asyncio.gather(*(one(member) for member in members))
        ready.put(len(clients))
        await asyncio.Event().wait()

    asyncio.run(main())


def _wait(process: multiprocessing.Process, ready: "Queue[int]") -> None:
    """Wait for the nodes, but not for a process that has failed."""
    end = time.monotonic() + _WITHIN
    while time.monotonic() < end:
        with contextlib.suppress(queue.Empty):
            ready.get(timeout=1)
            return
        if not process.is_alive():
            break
    raise RuntimeError("not all nodes came")


@contextlib.contextmanager
def secure(members: Sequence[EnrolledNode], port: int, anchor: bytes) -> Iterator[None]:
    """Nodes at our master."""
    ready: Queue[int] = multiprocessing.Queue()
    process = multiprocessing.Process(target=_nodes, args=(members, port, anchor, ready), daemon=True)
    process.start()
    try:
        _wait(process, ready)
        yield
    finally:
        process.kill()
        process.join()


@contextlib.contextmanager
def plain(names: Sequence[str], port: int) -> Iterator[None]:
    """Nodes at stock rosmaster, each with a connection that stays."""
    lines = []
    for number, name in enumerate(names):
        line = Line(port)
        for method, *params in registrations(name, f"http://127.0.0.1:{20000 + number}/"):
            line.ask(request(str(method), name, *params))
        lines.append(line)
    try:
        yield
    finally:
        for line in lines:
            line.sock.close()
