"""A mesh of masters, each of which follows all others: what a change costs. Not in the thesis.

Masters are processes on loopback; between two of them is a meter, which counts the bytes of TCP's
payload and how often something was read. A change is a registration at the first master; it is
everywhere when a subscriber of every other one was told. Silence is subtracted.
"""

import asyncio
import time
from contextlib import AsyncExitStack, ExitStack
from pathlib import Path
from statistics import median
from typing import Any, Final

from bench._sites import TYPE, Meter, Slave, enroll_masters, master, slave
from rossec.ros.names import MASTER
from tests.support.ports import free_port
from tests.support.site import Site

CHANGES: Final = 20
TOPIC: Final = "/publisher/t"
_CONNECTED: Final = 5.0  # seconds until all follow all, and the wants are known
_SILENCE: Final = 5.0  # as long as a poll


def names(count: int) -> list[str]:
    """The masters of a mesh."""
    return [MASTER, *(f"{MASTER}/m{number}" for number in range(1, count))]


def labels(masters: list[str]) -> dict[str, str]:
    """What each of them is called by the others."""
    return {name: name.rpartition("/")[2] for name in masters}


def measure(sizes: tuple[int, ...], directory: Path) -> dict[str, Any]:
    """By the number of masters: bytes, reads and milliseconds of a change."""
    site = Site(directory / "site")
    enroll_masters(site, names(max(sizes)))
    return {str(count): asyncio.run(_mesh(site, count)) for count in sizes}


async def _mesh(site: Site, count: int) -> dict[str, float]:
    masters = names(count)
    ports = {name: free_port() for name in masters}
    meters = list[Meter]()
    async with AsyncExitStack() as stack:
        follows = dict[str, dict[str, tuple[str, int]]]()
        for name in masters:
            follows[name] = {}
            for other in masters:
                if other != name:
                    meter = Meter(ports[other])
                    await stack.enter_async_context(meter.running())
                    meters.append(meter)
                    follows[name][labels(masters)[other]] = (other, meter.port)
        running = stack.enter_context(ExitStack())
        for name in masters:
            start = master(site, name, follows[name], ports[name])
            await asyncio.to_thread(running.enter_context, start)  # the meters go on
        there = await stack.enter_async_context(slave(site, "/publisher", ports[masters[0]]))
        here = [
            await stack.enter_async_context(slave(site, f"/subscriber{n}", ports[name]))
            for n, name in enumerate(masters[1:])
        ]
        for each in here:
            await each.ask("registerSubscriber", TOPIC, TYPE, each.uri)
        await asyncio.sleep(_CONNECTED)
        return await _changes(there, here, meters)


async def _changes(there: Slave, here: list[Slave], meters: list[Meter]) -> dict[str, float]:
    quiet = await _during(meters, asyncio.sleep(_SILENCE))
    taken = list[float]()
    busy = await _during(meters, _change(there, here, taken))
    return {
        "change_ms": round(median(taken) * 1000, 1),
        "bytes_a_change": _less_silence(busy, quiet, 0),
        "reads_a_change": _less_silence(busy, quiet, 1),
        "silence_bytes_per_s": round(quiet[0] / quiet[2], 1),
    }


async def _change(there: Slave, here: list[Slave], taken: list[float]) -> None:
    """Register and unregister; how long each registration took to be everywhere."""
    for _ in range(CHANGES):
        begin = time.perf_counter()
        await there.ask("registerPublisher", TOPIC, TYPE, there.uri)
        taken.append(max([await each.until(there.uri, named=True) for each in here]) - begin)
        await there.ask("unregisterPublisher", TOPIC, there.uri)
        for each in here:
            await each.until(there.uri, named=False)


async def _during(meters: list[Meter], work: Any) -> tuple[float, float, float]:
    """Bytes, reads and seconds meanwhile."""
    before = sum(each.count for each in meters), sum(each.reads for each in meters)
    begin = time.perf_counter()
    await work
    after = sum(each.count for each in meters), sum(each.reads for each in meters)
    return after[0] - before[0], after[1] - before[1], time.perf_counter() - begin


def _less_silence(busy: tuple[float, float, float], quiet: tuple[float, float, float], figure: int) -> float:
    """Of one change; a registration and its end are two."""
    idle = quiet[figure] / quiet[2] * busy[2]
    return round((busy[figure] - idle) / (2 * CHANGES), 1)
