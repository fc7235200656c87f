"""Delivery: from the authority's deposit until a running node may publish by the new grant.

A hundred built-in nodes without rights wait at `rossec master`, in one process beside it. A node is
done when its registration, which was refused before, is accepted. A deposit is for one of them, as
after `rossec grant sign`, or for all (two calls), as after `rossec policy apply`: then the nodes
share the time of one processor, which nodes on robots of their own do not.
"""

import asyncio
import contextlib
import multiprocessing
import resource
import secrets
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from multiprocessing.queues import Queue
from pathlib import Path
from typing import NamedTuple

from bench._masters import ours
from ca.certificates import TrustAnchor
from grants import document
from grants.model import Draft, Permission, Right
from rossec.errors import AnswerRefused
from rossec.net.aio import SecureContext, WireProtocol, connect
from rossec.net.rpc import RpcClient
from rossec.node import Node
from rossec.ros.names import AUTHORITY
from tests.support.site import DAY, Site

NODES = 100
ROUNDS = 10
SINGLE = 20  # nodes of a round that get a grant alone
_BATCH = 64

Arrival = tuple[str, float]
"""A node, and when it may publish, by the monotonic clock, which processes share."""


class WaitingNode(Node):
    """A node that registers the topic of each round as soon as it may."""

    arrivals: "Queue[Arrival]"
    round = 0

    async def rights_changed(self) -> None:
        """Register the topic of this round, as a publisher does that was refused."""
        topic = f"{self.name}/t{self.round}"
        try:
            await self._context.call("registerPublisher", topic, "std_msgs/String", self.uri)
        except AnswerRefused:
            return
        self.arrivals.put((topic, time.monotonic()))
        self.round += 1


def _nodes(names: Sequence[str], environ: dict[str, str], arrivals: "Queue[Arrival]") -> None:
    limit = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    resource.setrlimit(resource.RLIMIT_NOFILE, (limit, limit))

    async def main() -> None:
        nodes = [WaitingNode(name, environ=environ) for name in names]
        for node in nodes:
            node.arrivals = arrivals
            await node.__aenter__()
        arrivals.put(("ready", time.monotonic()))
        await asyncio.Event().wait()

    asyncio.run(main())


def _grant(site: Site, name: str, pattern: str) -> bytes:
    now = site.now()
    draft = Draft(
        domain=site.anchor.domain,
        subject=name,
        holder=site.identity(name).thumbprint,
        not_before=now - 60,
        expires=now + DAY,
        cap=now + DAY,
        serial=secrets.token_bytes(16),
        permissions=(Permission(pattern, Right.PUBLISH),),
    )
    return document.sign(site.authority.signer, draft)


async def _deposit(site: Site, port: int, anchor: TrustAnchor, grants: Sequence[bytes]) -> float:
    """Deposit grants as `rossec grant sign` does, over a new connection; returns the start."""
    own = SecureContext(site.enroll(AUTHORITY).credentials(), anchor.verify)
    began = time.monotonic()
    client = RpcClient(await connect("127.0.0.1", port, own, WireProtocol.HTTP))
    for at in range(0, len(grants), _BATCH):
        reasons = await client.ask("rossec.depositGrants", AUTHORITY, grants[at : at + _BATCH])
        if not isinstance(reasons, list) or any(reasons):
            raise RuntimeError(f"the master refuses grants: {reasons}")
    await client.close()
    return began


class Fleet(NamedTuple):
    """The running nodes, and how to reach their master."""

    site: Site
    port: int
    names: Sequence[str]
    arrivals: "Queue[Arrival]"
    topics: Counter[str]

    def deliver(self, names: Sequence[str]) -> list[float]:
        """Deposit a grant for each node; seconds until each of them uses it."""
        grants = [_grant(self.site, name, f"{name}/t{self.topics[name]}") for name in names]
        self.topics.update(names)
        began = asyncio.run(_deposit(self.site, self.port, self.site.anchor, grants))
        found = dict(self.arrivals.get(timeout=60) for _ in names)
        if len(found) != len(names):
            raise RuntimeError("a node has registered twice")
        return [arrived - began for arrived in found.values()]


@contextlib.contextmanager
def running(nodes: int) -> Iterator[Fleet]:
    """A master and `nodes` nodes without rights, which wait."""
    names = [f"/robot{number}" for number in range(nodes)]
    with tempfile.TemporaryDirectory() as folder:
        site = Site(Path(folder) / "site")
        for name in names:
            site.enroll(name)
        with ours(site) as master:
            environ = {
                "ROSSEC_HOME": str(site.root),
                "ROS_IP": "127.0.0.1",
                "ROS_MASTER_URI": f"http://127.0.0.1:{master.port}/",
            }
            arrivals: Queue[Arrival] = multiprocessing.Queue()
            process = multiprocessing.Process(target=_nodes, args=(names, environ, arrivals), daemon=True)
            process.start()
            try:
                arrivals.get(timeout=120)
                time.sleep(1.5)
                yield Fleet(site, master.port, names, arrivals, Counter())
            finally:
                process.kill()
                process.join()


def _percentile(found: Sequence[float], percent: int) -> float:
    return round(1000 * sorted(found)[len(found) * percent // 100], 1)


def figures() -> dict[str, float]:
    """Milliseconds at a hundred nodes: a grant for one of them, and one for each in one deposit."""
    one, everyone = list[float](), list[float]()
    with running(NODES) as fleet:
        for _ in range(ROUNDS):
            for name in fleet.names[:: NODES // SINGLE]:
                one += fleet.deliver([name])
                time.sleep(0.01)
        for _ in range(ROUNDS):
            everyone += fleet.deliver(fleet.names)
            time.sleep(1)
    return {
        "deliver_ms_p50": _percentile(one, 50),
        "deliver_ms_p99": _percentile(one, 99),
        "deliver_to_all_ms_p99": _percentile(everyone, 99),
    }
