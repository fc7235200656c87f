"""Another node's call, and a revocation, while a node floods the master with calls of 1 MiB.

The flood comes from a process of its own: 32 or 256 connections, of a node that has no right, of
many such nodes, and of nodes that may set parameters. Each connection sends the next call when the
last one is answered, and connects again when it was closed. Wanted: another node's call within
250 ms, and a revoked node's connection cut within 500 ms, at every load.
"""

import asyncio
import contextlib
import multiprocessing
import os
import tempfile
import time
from multiprocessing.synchronize import Event
from pathlib import Path
from statistics import median
from typing import Any, Final

from bench._masters import EnrolledNode, Master, enroll, ours
from ca.certificates import TrustAnchor
from grants.model import Right
from rossec.errors import ChannelError, RossecError
from rossec.net.aio import SecureContext, SecureStream, WireProtocol, connect
from rossec.net.rpc import RpcClient
from rossec.ros.calls import CallClient
from tests.support.site import Site

WITHOUT: Final = {"/none": Right.SUBSCRIBE}
SIZE: Final = 1024 * 1024
_PACE: Final = 0.02  # seconds between two calls that are timed


async def _dial(master: Master, node: EnrolledNode, anchor: TrustAnchor) -> SecureStream[Any]:
    own = SecureContext(node.credentials, anchor.verify)
    return await connect("127.0.0.1", master.port, own, WireProtocol.HTTP)


def _body(name: str) -> bytes:
    """A call of about 1 MiB, which has as many values as there is room for."""
    calls = CallClient("x", compact=False)
    return calls.request("setParam", (name, f"{name}/big", [1] * (SIZE // 31)))


async def _flood_one(master: Master, node: EnrolledNode, anchor: TrustAnchor, *, shown: bool) -> None:
    body = _body(node.name)
    while True:
        with contextlib.suppress(RossecError, OSError):
            stream = await _dial(master, node, anchor)
            if shown:
                client = RpcClient(stream, compact=False)
                await client.call("rossec.presentGrants", node.name, [node.grant])
            while True:
                await stream.send(body)
                await stream.receive()
        await asyncio.sleep(0.2)


def _flood(
    master: Master, nodes: list[EnrolledNode], anchor: TrustAnchor, count: int, shown: bool, begun: Event
) -> None:
    os.nice(5)  # a real attacker has a computer of its own

    async def main() -> None:
        asyncio.get_running_loop().call_later(1, begun.set)
        await asyncio.gather(
            *(_flood_one(master, nodes[number % len(nodes)], anchor, shown=shown) for number in range(count))
        )

    asyncio.run(main())


async def _round_trips(client: RpcClient, name: str, seconds: float) -> list[float]:
    """How long each call of another node takes, in milliseconds."""
    took, end = list[float](), time.monotonic() + seconds
    while time.monotonic() < end:
        began = time.monotonic()
        await client.call("getPid", name)
        took.append((time.monotonic() - began) * 1000)
        await asyncio.sleep(_PACE)
    return took


async def _cut(site: Site, stream: SecureStream[Any], node: EnrolledNode, sender: RpcClient) -> float:
    """Milliseconds from handing in the list that revokes `node` to the end of its connection."""
    revoked = site.revoke(node.identity.thumbprint)
    began = time.monotonic()
    await sender.call("rossec.updateRevocations", "/other", revoked)
    with contextlib.suppress(ChannelError):
        while True:
            await asyncio.wait_for(stream.receive(), 60)
    return (time.monotonic() - began) * 1000


async def _others(site: Site, master: Master, begun: Event, seconds: float) -> dict[str, float]:
    other, victim = enroll(site, "/other"), enroll(site, "/victim")
    client = RpcClient(await _dial(master, other, site.anchor), deadline=60)
    await client.call("rossec.presentGrants", other.name, [other.grant])
    watched = await _dial(master, victim, site.anchor)
    await asyncio.to_thread(begun.wait)
    took = await _round_trips(client, other.name, seconds)
    cut = await _cut(site, watched, victim, client)
    return {
        "call ms median": round(median(took), 1),
        "call ms most": round(max(took), 1),
        "revocation ms": round(cut, 1),
    }


def _under(
    site: Site, master: Master, nodes: list[EnrolledNode], count: int, shown: bool, seconds: float
) -> dict[str, float]:
    processes = multiprocessing.get_context("fork")
    begun = processes.Event()
    flood = processes.Process(target=_flood, args=(master, nodes, site.anchor, count, shown, begun))
    flood.start()
    try:
        return asyncio.run(_others(site, master, begun, seconds))
    finally:
        flood.kill()
        flood.join()


def measure(seconds: float) -> dict[str, Any]:
    """By flood: how long others wait."""
    found: dict[str, Any] = {}
    loads = [(keys, count, shown) for keys in (1, 32) for count in (32, 256) for shown in (0, 1)]
    with tempfile.TemporaryDirectory() as folder:
        site = Site(Path(folder) / "site")
        with ours(site) as master:
            for keys, count, shown in loads:
                rights = None if shown else WITHOUT
                nodes = [enroll(site, f"/flood{number}", rights) for number in range(keys)]
                who = f"{count} connections, {keys} keys {'with' if shown else 'without'} a right"
                found[who] = _under(site, master, nodes, count, bool(shown), seconds / len(loads))
    return found
