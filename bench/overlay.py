"""Bytes between two sites through routers of the overlay, each program a process, on loopback.

`direct` is a `SecureStream` over TCP; `router1` and `router2` are one over a link through one and
two routers; `relay1` is `direct` by a forwarded port of a relay, a router between and another relay, as nodes
of two sites have it. `raw_router1` is Zenoh alone, without seals and acknowledgements; `splice1` is
`direct` through a program that copies bytes. Latency is half of an echo, in microseconds;
throughput is of a loop of sends until the far side has all. `sealed_vs_raw` is the ratio of
latencies of `router1`. Gaps: 200 echoes a second through a triangle of routers, of which the one in
use is killed or stopped. Ways take turns. Wanted: `sealed_vs_raw` 2.5, gaps 1,000 and 5,000 ms.
"""

import asyncio
import signal
import time
from collections import defaultdict
from collections.abc import Awaitable, Callable
from contextlib import AsyncExitStack, suppress
from itertools import pairwise
from statistics import median
from typing import Any, Final

from bench import _overlay
from bench._overlay import ECHO, ONE_ROUTER, RAW, RAW_BACK, SINK, TWO_ROUTERS, Pipe, head
from ca.certificates import Identity
from rossec.errors import ChannelError
from rossec.net.aio import SecureStream, connect
from rossec.overlay.documents import OPEN_ACCOUNT, Routers
from rossec.overlay.endpoint import dial_link
from rossec.overlay.router_settings import client_settings
from rossec.overlay.zenoh_carrier import Carrier, open_session

SIZES: Final = {100: 200, 10_000: 200, 1_000_000: 20}  # and how many echoes are a sample
VOLUME: Final = {100: 200_000, 10_000: 8_000_000, 1_000_000: 64_000_000}  # bytes of a sample
HANDSHAKES: Final = 10
RATE: Final = 200
TRIALS: Final = {signal.SIGKILL: 3, signal.SIGSTOP: 2}


class Raw:
    """Zenoh alone, used from the loop as a `Pipe`."""

    def __init__(self, session: Any) -> None:
        import zenoh  # noqa: PLC0415 - with the extra only

        self._block = zenoh.CongestionControl.BLOCK
        self._session = session
        self._loop = asyncio.get_running_loop()
        self._arrived: asyncio.Queue[bytes] = asyncio.Queue()
        self._subscriber = session.declare_subscriber(RAW_BACK, self._receive)

    def _receive(self, sample: Any) -> None:
        data = sample.payload.to_bytes()
        self._loop.call_soon_threadsafe(self._arrived.put_nowait, data)

    async def send(self, *pieces: bytes) -> None:
        """Put the pieces as one message."""
        self._session.put(RAW, b"".join(pieces), congestion_control=self._block)

    async def receive(self) -> bytes:
        """Return the next message."""
        return await self._arrived.get()


async def latency(pipe: Pipe, size: int) -> float:
    """Seconds one way."""
    data, begin = bytes(size), time.perf_counter()
    for _ in range(SIZES[size]):
        await pipe.send(head(ECHO, size), data)
        left = size
        while left > 0:
            left -= len(await pipe.receive())
    return (time.perf_counter() - begin) / SIZES[size] / 2


async def throughput(pipe: Pipe, size: int) -> float:
    """Bytes per second."""
    data, count = bytes(size), VOLUME[size] // size
    begin = time.perf_counter()
    await pipe.send(head(SINK, size * count))
    for _ in range(count):
        await pipe.send(data)
    await pipe.receive()
    return size * count / (time.perf_counter() - begin)


Samples = dict[str, dict[str, list[float]]]


async def rounds(pipes: dict[str, Pipe], seconds: float) -> tuple[Samples, Samples]:
    """Latencies and throughputs, by way and size; the first round warms up."""
    taken: tuple[Samples, Samples] = (_samples(), _samples())
    end = None
    while end is None or time.monotonic() < end:
        found = (_samples(), _samples()) if end is None else taken
        for size in SIZES:
            for name, pipe in pipes.items():
                found[0][name][str(size)].append(await latency(pipe, size))
                found[1][name][str(size)].append(await throughput(pipe, size))
        end = time.monotonic() + seconds if end is None else end
    return taken


def _samples() -> Samples:
    return defaultdict(lambda: defaultdict(list))


async def handshake(make: Callable[[], Awaitable[SecureStream[Identity]]]) -> float:
    """Milliseconds for a connection and its first echo."""
    taken = []
    for _ in range(HANDSHAKES):
        begin = time.perf_counter()
        stream = await make()
        await stream.send(head(ECHO, 1), b"x")
        await stream.receive()
        taken.append((time.perf_counter() - begin) * 1000)
        await stream.close()
    return round(median(taken), 1)


async def compare(seconds: float) -> dict[str, Any]:
    """Latency, throughput and handshakes of all ways."""
    async with AsyncExitStack() as stack:
        programs = stack.enter_context(_overlay.programs())
        near = programs.router()
        far = programs.router(near)
        port = programs.far(near, far)
        spliced, forwarded_port = programs.splice(port), programs.relays(near, port)
        own = _overlay.context(programs.folder, "client")
        carrier = await Carrier.open(Routers((near,), OPEN_ACCOUNT))
        stack.push_async_callback(carrier.close)
        makers: dict[str, Callable[[], Awaitable[SecureStream[Identity]]]] = {
            "direct": lambda: connect("127.0.0.1", port, own),
            "router1": lambda: dial_link(carrier, ONE_ROUTER, OPEN_ACCOUNT, own),
            "router2": lambda: dial_link(carrier, TWO_ROUTERS, OPEN_ACCOUNT, own),
            "relay1": lambda: connect("127.0.0.1", forwarded_port, own),
            "splice1": lambda: connect("127.0.0.1", spliced, own),
        }
        pipes: dict[str, Pipe] = {
            name: await stack.enter_async_context(await make()) for name, make in makers.items()
        }
        session = open_session(client_settings(Routers((near,), OPEN_ACCOUNT)))
        stack.callback(session.close)
        pipes["raw_router1"] = Raw(session)
        await asyncio.sleep(0.5)  # until routers know of every subscription
        latencies, throughputs = await rounds(pipes, seconds)
        handshakes = {name: await handshake(make) for name, make in makers.items()}
    return _report(latencies, throughputs, handshakes)


def _report(latencies: Samples, throughputs: Samples, handshakes: dict[str, float]) -> dict[str, Any]:
    sealed, raw = latencies["router1"], latencies["raw_router1"]
    return {
        "latency_us": {
            name: {size: round(median(taken) * 1e6, 1) for size, taken in sizes.items()}
            for name, sizes in latencies.items()
        },
        "throughput_mb_s": {
            name: {size: round(median(taken) / 1e6, 1) for size, taken in sizes.items()}
            for name, sizes in throughputs.items()
        },
        "sealed_vs_raw": {
            size: round(median(a / b for a, b in zip(taken, raw[size], strict=True)), 2)
            for size, taken in sealed.items()
        },
        "handshake_ms": handshakes,
    }


# -- gaps


async def gap(number: signal.Signals) -> float:
    """The longest pause of 200 echoes a second when the router in use gets this signal, in ms."""
    async with AsyncExitStack() as stack:
        programs = stack.enter_context(_overlay.programs())
        triangle = [programs.router()]
        triangle.append(programs.router(*triangle))
        triangle.append(programs.router(*triangle))
        programs.far("", "", *triangle)
        carrier = await Carrier.open(Routers(tuple(triangle), OPEN_ACCOUNT))
        stack.push_async_callback(carrier.close)
        own = _overlay.context(programs.folder, "client")
        stream = await dial_link(carrier, ONE_ROUTER, OPEN_ACCOUNT, own)
        stack.callback(stream.abort, "measured")
        arrivals = [time.perf_counter()]
        echoes = asyncio.gather(_send(stream), _receive(stream, arrivals))
        await asyncio.sleep(2)
        used = carrier.router
        programs.signal_router(next(each for each in triangle if each in used), number)
        await asyncio.sleep(3 if number is signal.SIGKILL else 7)
        echoes.cancel()
        with suppress(asyncio.CancelledError, ChannelError):
            await echoes
        arrivals.append(time.perf_counter())
    return round(max(b - a for a, b in pairwise(arrivals)) * 1000, 1)


async def _send(stream: SecureStream[Identity]) -> None:
    while True:
        await stream.send(head(ECHO, 100), bytes(100))
        await asyncio.sleep(1 / RATE)


async def _receive(stream: SecureStream[Identity], arrivals: list[float]) -> None:
    while True:
        await stream.receive()
        arrivals.append(time.perf_counter())


async def gaps(number: signal.Signals) -> float:
    """The median of some trials."""
    return round(median([await gap(number) for _ in range(TRIALS[number])]), 1)


def measure(seconds: float) -> dict[str, object]:
    """Measure for about `seconds`, and a minute for the gaps."""
    return {
        **asyncio.run(compare(seconds)),
        "kill_gap_ms": asyncio.run(gaps(signal.SIGKILL)),
        "stop_gap_ms": asyncio.run(gaps(signal.SIGSTOP)),
    }
