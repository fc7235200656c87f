"""Masters that follow each other, as processes of their own on loopback.

`change_ms_*`: from a registration at one master to `publisherUpdate` at a subscriber of another.
Beside it the same by FKIE's constants (multimaster_fkie 5e74691), with the same masters: the own
master is polled at 1 Hz, then a random wait of 0 to 2 s, then the whole state is pulled.
`silence_bytes_per_s`: payload of TCP both ways, for a pair without changes. `whole_5000_s`: from
the connection to 5,000 facts at a watcher of the follower. `rss_added_mb_10x1000`: what ten sites
of 1,000 facts add to a master. Wanted: 120 ms median, 200 B/s, 2 s, 40 MB.
"""

import asyncio
import tempfile
import time
from contextlib import AsyncExitStack, ExitStack
from pathlib import Path
from secrets import SystemRandom
from typing import Any

from bench._foreign import chains, handshakes
from bench._latency import percentile
from bench._masters import Master
from bench._sites import TYPE, Meter, Slave, enroll_masters, master, register_facts, slave
from rossec.participant.registrations import WATCH_GRAPH, GraphView
from rossec.ros.names import MASTER
from tests.support.site import Site

OTHER = "/master/other"
SITES = 10
ROUNDS = 40
FKIE_ROUNDS = 12
POLL, MOST_WAIT = 1.0, 2.0  # seconds; FKIE's ROSMASTER_HZ is 1, and sync_thread waits randint(0, 2)
TOPIC = "/publisher/t"
_RANDOM = SystemRandom()


async def changes(site: Site, other: Master, follower: Master, rounds: int) -> list[float]:
    """Milliseconds from each registration to the update."""
    taken = list[float]()
    async with (
        slave(site, "/publisher", other.port) as there,
        slave(site, "/subscriber", follower.port) as here,
    ):
        await here.ask("registerSubscriber", TOPIC, TYPE, here.uri)
        for _ in range(rounds):
            await asyncio.sleep(_RANDOM.uniform(0.1, 0.4))
            begin = time.perf_counter()
            await there.ask("registerPublisher", TOPIC, TYPE, there.uri)
            taken.append((await here.until(there.uri, named=True) - begin) * 1000)
            await there.ask("unregisterPublisher", TOPIC, there.uri)
            await here.until(there.uri, named=False)
    return sorted(taken)


async def fkie_changes(site: Site, other: Master, follower: Master) -> list[float]:
    """The same by FKIE's constants: a synchronization node between two masters."""
    taken = list[float]()
    async with AsyncExitStack() as stack:
        there = await stack.enter_async_context(slave(site, "/publisher", other.port))
        here = await stack.enter_async_context(slave(site, "/subscriber", follower.port))
        discovery = await stack.enter_async_context(slave(site, "/discovery", other.port))
        sync = await stack.enter_async_context(slave(site, "/sync", follower.port, TOPIC))
        await here.ask("registerSubscriber", TOPIC, TYPE, here.uri)
        syncing = await stack.enter_async_context(asyncio.TaskGroup())
        task = syncing.create_task(_synchronize(discovery, sync))
        for _ in range(FKIE_ROUNDS):
            await asyncio.sleep(_RANDOM.uniform(0.1, 1.1))
            begin = time.perf_counter()
            await there.ask("registerPublisher", TOPIC, TYPE, there.uri)
            taken.append((await here.until(sync.uri, named=True) - begin) * 1000)
            await there.ask("unregisterPublisher", TOPIC, there.uri)
            await here.until(sync.uri, named=False)
        task.cancel()
    return sorted(taken)


async def _synchronize(discovery: Slave, sync: Slave) -> None:
    """Poll one master, and after a change pull its whole state and register it at the other."""
    state: Any = None
    while True:
        found = await discovery.ask("getSystemState")
        if found != state:
            await asyncio.sleep(_RANDOM.uniform(0, MOST_WAIT))
            whole: Any = await discovery.ask("getSystemState")
            state = whole
            named = any(entry[0] == TOPIC for entry in whole[0])
            method = "registerPublisher" if named else "unregisterPublisher"
            await sync.ask(method, TOPIC, *([TYPE] if named else []), sync.uri)
        await asyncio.sleep(POLL)


async def silence(site: Site, other: Master, seconds: float) -> float:
    """Bytes a second between two masters, of which nothing changes."""
    async with Meter(other.port).running() as meter:
        with master(site, MASTER, {"other": (OTHER, meter.port)}) as follower:
            async with slave(site, "/subscriber", follower.port) as here:
                await here.ask("registerSubscriber", TOPIC, TYPE, here.uri)
                await meter.used.wait()
                await asyncio.sleep(7)  # connected, and the wants are known
                before, begin = meter.count, time.perf_counter()
                await asyncio.sleep(seconds)
                return (meter.count - before) / (time.perf_counter() - begin)


async def whole(site: Site, other: Master, facts: int) -> float:
    """Seconds from the connection to `facts` facts at a watcher of the follower."""
    async with AsyncExitStack() as stack:
        for number in range(-(-facts // 2000)):
            node = await stack.enter_async_context(slave(site, f"/n{number}", other.port))
            await register_facts(node, min(2000, facts - 2000 * number))
        meter = Meter(other.port)
        async with meter.running():
            with master(site, MASTER, {"other": (OTHER, meter.port)}) as follower:
                tool = await stack.enter_async_context(slave(site, "/tool", follower.port))
                return await _watched(tool, facts) - meter.opened


async def _watched(tool: Slave, facts: int) -> float:
    """When a watcher knows so many facts."""
    view = GraphView()
    while len(view.facts) < facts:
        view.take(await tool.ask(WATCH_GRAPH, *view.next_params))
    return time.perf_counter()


async def memory(site: Site) -> float:
    """Megabytes that ten sites with 1,000 facts each add to a master."""
    names = [f"{MASTER}/s{number}" for number in range(SITES)]
    with ExitStack() as running:
        others = {name: running.enter_context(master(site, name)) for name in names}
        async with AsyncExitStack() as stack:
            for number, other in enumerate(others.values()):
                node = await stack.enter_async_context(slave(site, f"/m{number}", other.port))
                await register_facts(node, 1000)
            follows = {name.rpartition("/")[2]: (name, other.port) for name, other in others.items()}
            alone = await _memory_with(site, {}, 0)
            return (await _memory_with(site, follows, SITES * 1000) - alone) / 1000


async def _memory_with(site: Site, follows: dict[str, tuple[str, int]], facts: int) -> float:
    with master(site, MASTER, follows) as follower:
        async with slave(site, "/tool", follower.port) as tool:
            await _watched(tool, facts)
            await asyncio.sleep(12)  # and a round of everything that is periodic
            return float(follower.rss())


def _figures(site: Site, seconds: float) -> dict[str, Any]:
    with master(site, OTHER) as other:
        with master(site, MASTER, {"other": (OTHER, other.port)}) as follower:
            taken = asyncio.run(changes(site, other, follower, ROUNDS))
        with master(site) as follower:
            fkie = asyncio.run(fkie_changes(site, other, follower))
        quiet = asyncio.run(silence(site, other, max(10.0, seconds)))
        return {
            "change_ms_p50": percentile(taken, 0.5),
            "change_ms_p99": percentile(taken, 0.99),
            "change_ms_p50_fkie": percentile(fkie, 0.5),
            "silence_bytes_per_s": round(quiet),
            "whole_5000_s": round(asyncio.run(whole(site, other, 5000)), 2),
        }


def measure(seconds: float) -> dict[str, Any]:
    """All of it."""
    with tempfile.TemporaryDirectory() as folder:
        site = Site(Path(folder) / "site")
        enroll_masters(site, [MASTER, OTHER, *(f"{MASTER}/s{number}" for number in range(SITES))])
        figures = _figures(site, seconds)
        added = round(asyncio.run(memory(site)), 1)
    share = min(3.0, seconds / 4)
    return {**figures, "rss_added_mb_10x1000": added, **handshakes(share), **chains(share)}
