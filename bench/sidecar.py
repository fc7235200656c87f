"""Unmodified roscpp programs: plain, through two sidecars, and through two TLS tunnels (stunnel).

Real processes on loopback, the three kinds in turn within every round; a sample is the time from
the first `publish` to the last callback of a burst that is queued without loss, a ratio the median
of the rounds' ratios. Latency is one way, at 100 Hz. Memory is the resident memory of one host's
sidecar, with 1 and with 50 nodes behind it, beside Debian's roscore (rosmaster, roslaunch, rosout)
with the same nodes.
"""

import asyncio
import contextlib
import os
import socket
import statistics
import sys
import tempfile
from collections import defaultdict
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any, Final

from bench.rospy import Pair, tunnel
from grants.model import Right
from tests.support import roscpp, stock
from tests.support.fleet import Program, entitle
from tests.support.site import Site
from tests.support.witness import until

SIZES: Final = {100: 20_000, 10_000: 8_000, 1_000_000: 100}
MODES: Final = ("plain", "rossec", "stunnel")
NODES: Final = 50
_ROSSEC: Final = str(Path(sys.executable).with_name("rossec"))
_TUNNELLED: Final = "127.0.0.3"  # roscpp listens on 127.0.0.1 whatever loopback address it tells
_SOURCE: Final = Path(__file__).with_name("talk.cpp")


@contextlib.asynccontextmanager
async def talking(env: dict[str, str], *command: str) -> AsyncIterator[Program]:
    """A program that is told what to do on its standard input."""
    process = await asyncio.create_subprocess_exec(
        *command, env=env, stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE,
        limit=1 << 20,
    )  # fmt: skip
    try:
        running = Program(process)
        await running.hears("READY")
        yield running
    finally:
        if process.returncode is None:
            process.terminate()
        await process.communicate()


@contextlib.asynccontextmanager
async def pairs(folder: Path, site: Site, talk: str) -> AsyncIterator[dict[str, Pair]]:
    """A publisher and a subscriber of each kind."""
    port = _free_port()
    async with contextlib.AsyncExitStack() as stack:
        plain = await stack.enter_async_context(stock.rosmaster(folder / "master"))
        tunnelled = await stack.enter_async_context(stock.rosmaster(folder / "tunnelled"))
        stack.enter_context(tunnel(folder / "tunnel", port, port, outer_host=_TUNNELLED))
        env = {
            "plain": stock.environment(plain, folder / "logs"),
            "rossec": {**stock.environment("", folder / "logs"), **site.environ},
            "stunnel": stock.environment(tunnelled, folder / "logs"),
        }
        made = {}
        for mode in MODES:
            secured = (_ROSSEC, "run", "--") if mode == "rossec" else ()
            there = env[mode]
            fixed: tuple[str, ...] = ()
            if mode == "stunnel":
                there = {**there, "ROS_IP": _TUNNELLED}
                fixed = (f"__tcpros_server_port:={port}",)
            publisher = await stack.enter_async_context(
                talking(there, *secured, talk, "publisher", *fixed)
            )
            subscriber = await stack.enter_async_context(
                talking(env[mode], *secured, talk, "subscriber")
            )
            made[mode] = Pair(publisher, [subscriber])
        yield made


async def _sample(folder: Path, seconds: float) -> dict[str, Any]:
    times: dict[tuple[int, str], list[float]] = defaultdict(list)
    delays: dict[str, list[float]] = defaultdict(list)
    talk = str(roscpp.compiled(folder, _SOURCE))
    async with Site(folder / "site").running() as site:
        entitle(site, "/bench_publisher", {Right.PUBLISH: ("/bench/text",)})
        entitle(site, "/bench_subscriber", {Right.SUBSCRIBE: ("/bench/text",)})
        async with pairs(folder, site, talk) as made:
            loop = asyncio.get_running_loop()
            end, rounds = loop.time() + seconds, 0
            while rounds < 3 or loop.time() < end:
                for size, count in SIZES.items():
                    for mode in MODES if rounds % 2 else reversed(MODES):
                        if rounds == 0:
                            await made[mode].burst("text", size, max(1, count // 4))  # warm
                        times[size, mode].append(await made[mode].burst("text", size, count))
                for mode in MODES:
                    delays[mode] += await made[mode].delays()
                rounds += 1
        memory = await _memory(folder, site, talk)
    return {**_figures(times, delays), **memory, "rounds": rounds}


def _figures(
    times: dict[tuple[int, str], list[float]], delays: dict[str, list[float]]
) -> dict[str, Any]:
    def ratio(size: int, other: str) -> float:
        both = zip(times[size, other], times[size, "rossec"], strict=True)
        return round(statistics.median(theirs / ours for theirs, ours in both), 3)

    def added(percent: int, mode: str) -> float:
        at = [statistics.quantiles(delays[one], n=100)[percent - 1] for one in (mode, "plain")]
        return round(at[0] - at[1], 1)

    def rate(size: int, mode: str) -> float:
        return round(SIZES[size] / statistics.median(times[size, mode]), 1)

    return {
        "throughput_vs_stunnel": {str(size): ratio(size, "stunnel") for size in SIZES},
        "throughput_vs_plain": {str(size): ratio(size, "plain") for size in SIZES},
        "latency_added_us_p50": added(50, "rossec"),
        "latency_added_us_p99": added(99, "rossec"),
        "latency_added_us_p50_stunnel": added(50, "stunnel"),
        "messages_per_second": {
            mode: {str(size): rate(size, mode) for size in SIZES} for mode in MODES
        },
    }


async def _memory(folder: Path, site: Site, talk: str) -> dict[str, Any]:
    """Resident memory of a host's sidecar and of roscore, with 1 and with 50 nodes."""
    for number in range(NODES):
        entitle(site, f"/node{number}", {Right.SUBSCRIBE: ("/bench/text",)})
    port, core = _free_port(), _free_port()
    logs = folder / "logs"
    secured = {**stock.environment("", logs), **site.environ}
    plain = stock.environment(f"http://127.0.0.1:{core}/", logs)
    found: dict[str, list[float]] = {"sidecar": [], "roscore": []}
    async with contextlib.AsyncExitStack() as stack:
        enter = stack.enter_async_context
        sidecar = await enter(stock.process(secured, _ROSSEC, "sidecar", "-p", str(port)))
        roscore = await enter(stock.process(plain, "/usr/bin/roscore", "-p", str(core)))
        loopback = {**secured, "ROS_MASTER_URI": f"http://127.0.0.1:{port}/"}
        await until(lambda: all(_answers(one) for one in (port, core)), within=60)
        for numbers in (range(1), range(1, NODES)):
            words = [(talk, "subscriber", f"__name:=node{number}") for number in numbers]
            nodes = [talking(env, *one) for one in words for env in (loopback, plain)]
            await asyncio.gather(*(enter(node) for node in nodes))
            await asyncio.sleep(2)
            found["sidecar"].append(_resident(sidecar.pid))
            found["roscore"].append(_resident(roscore.pid))
    return {
        "rss_mb": dict(zip(("1", str(NODES)), found["sidecar"], strict=True)),
        "rss_mb_roscore": dict(zip(("1", str(NODES)), found["roscore"], strict=True)),
        "rss_vs_roscore": round(found["sidecar"][-1] / found["roscore"][-1], 2),
    }


def _resident(pid: int) -> float:
    """Megabytes of a process and its descendants."""
    parents: dict[int, list[int]] = defaultdict(list)
    for path in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            rest = path.read_text().rpartition(")")[2].split()
            parents[int(rest[1])].append(int(path.parent.name))
    total, waiting = 0, [pid]
    while waiting:
        one = waiting.pop()
        waiting += parents[one]
        with contextlib.suppress(OSError):
            total += int(Path(f"/proc/{one}/statm").read_text().split()[1])
    return round(total * os.sysconf("SC_PAGE_SIZE") / 1e6, 1)


def _free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port: int = free.getsockname()[1]
    return port


def _answers(port: int) -> bool:
    with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), 1):
        return True
    return False


def measure(seconds: float) -> dict[str, Any]:
    """All figures."""
    with tempfile.TemporaryDirectory() as folder:
        for name in ("master", "tunnelled", "logs"):
            (Path(folder) / name).mkdir()
        return asyncio.run(_sample(Path(folder), seconds))
