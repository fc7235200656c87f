"""Plain TCP, TLS 1.3 (mutual, P-256) and rossec, side by side through the real asyncio drivers.

Two processes on loopback. The variants take turns in slices of some hundredths of a second, so
that other load affects all of them; a ratio is the median over pairs of neighbouring slices,
`spread` its quartiles, and the first round is a warm-up. `throughput` is a loop of sends; rossec
joins what one turn of the loop sends, which is part of what is measured. `paced` gives the
loop a turn after every message, so that nothing can be joined. TLS verifies the peer's chain in full
each time, rossec one that it has seen before in its times alone; both learn its name, and close in order.
"""

import asyncio
import multiprocessing
import secrets
import tempfile
import time
from collections import defaultdict
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from multiprocessing.queues import Queue
from pathlib import Path
from statistics import median, quantiles
from typing import Any, TypeAlias

from bench import _site
from ca.certificates import Identity
from rossec.channel.connection import Connection
from rossec.channel.edhoc.credentials import KnownCertificates
from rossec.channel.edhoc.handshake import EdhocConfig
from rossec.channel.edhoc.suites import HYBRID, POST_QUANTUM
from rossec.errors import ChannelError
from rossec.net.aio import SecureContext, SecureStream, connect, serve
from tests.support.contexts import unlimited
from tests.support.wire import receive

SIZES = (64, 1024, 16 * 1024, 256 * 1024, 1024 * 1024, 6 * 1024 * 1024)
VOLUME = {64: 256 * 1024, 1024: 2 << 20}  # bytes per slice; the others below
LARGE_VOLUME = 16 << 20
MIN_BYTES = 3  # messages per slice
CONNECTIONS = 5  # per slice
ROUND_TRIPS = 100
HANDSHAKE_SLICES = 4

Makers: TypeAlias = Mapping[str, "Callable[[], Awaitable[Pipe]]"]
Samples: TypeAlias = dict[tuple[str, str], list[float]]


class Pipe:
    """The same methods over a `SecureStream` or over asyncio's streams."""

    def __init__(self, stream: SecureStream[Identity] | None, plain: Any = None) -> None:
        self._secure = stream
        self._plain = plain

    async def send(self, data: bytes) -> None:
        if self._secure is not None:
            await self._secure.send(data)
        else:
            self._plain[1].write(data)
            await self._plain[1].drain()

    async def receive(self) -> bytes:
        if self._secure is not None:
            return await self._secure.receive()
        data: bytes = await self._plain[0].read(1 << 20)
        if not data:
            raise EOFError
        return data

    async def close(self) -> None:
        if self._secure is not None:
            await self._secure.close()
        else:
            self._plain[1].close()  # over TLS this is close_notify, both ways
            with suppress(OSError):
                await self._plain[1].wait_closed()


async def sink(pipe: Pipe) -> None:
    """`count` in 8 bytes, then so many bytes, then answer one byte; for ever."""
    pending = b""
    try:
        while True:
            while len(pending) < 8:
                pending += await pipe.receive()
            left = int.from_bytes(pending[:8]) - len(pending) + 8
            while left > 0:
                left -= len(await pipe.receive())
            pending = b""
            await pipe.send(b"k")
    except (EOFError, ChannelError, OSError):
        await pipe.close()


def _server_process(folder: Path, ports: "Queue[tuple[int, int, int]]") -> None:
    async def main() -> None:
        async def plain(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            await sink(Pipe(None, (reader, writer)))

        async def secure(stream: SecureStream[Identity]) -> None:
            await sink(Pipe(stream))

        context = _site.tls(folder, "server", server=True)
        limit = 2 << 20
        a = await asyncio.start_server(plain, "127.0.0.1", 0, limit=limit)
        b = await asyncio.start_server(plain, "127.0.0.1", 0, limit=limit, ssl=context)
        c = serve(
            secure,
            "127.0.0.1",
            0,
            unlimited(
                _site.credentials(folder, "server"),
                _site.anchor(folder).verify,
                suites=POST_QUANTUM["prefer"],
                known=KnownCertificates(),
            ),
        )
        ports.put((*(s.sockets[0].getsockname()[1] for s in (a, b)), c.port))
        await asyncio.Event().wait()

    asyncio.run(main())


async def throughput(pipe: Pipe, size: int, *, paced: bool = False) -> float:
    """Seconds per message."""
    count = max(MIN_BYTES, VOLUME.get(size, LARGE_VOLUME) // size)
    data = bytes(size)
    start = time.perf_counter()
    await pipe.send((size * count).to_bytes(8))
    for _ in range(count):
        await pipe.send(data)
        if paced:
            await asyncio.sleep(0)
    await pipe.receive()
    return (time.perf_counter() - start) / count


async def latency(pipe: Pipe) -> float:
    """Seconds one way for 64 bytes."""
    start = time.perf_counter()
    for _ in range(ROUND_TRIPS):
        await pipe.send((56).to_bytes(8) + bytes(56))
        await pipe.receive()
    return (time.perf_counter() - start) / (2 * ROUND_TRIPS)


async def handshakes(make: Callable[[], Awaitable[Pipe]]) -> float:
    """Seconds per connection with one message there and back."""
    start = time.perf_counter()
    for _ in range(CONNECTIONS):
        pipe = await make()
        await pipe.send((56).to_bytes(8) + bytes(56))
        await pipe.receive()
        await pipe.close()
    return (time.perf_counter() - start) / CONNECTIONS


async def _measure(folder: Path, ports: tuple[int, int, int], seconds: float) -> dict[str, object]:
    context = _site.tls(folder, "client", server=False)
    own, verify = _site.credentials(folder, "client"), _site.anchor(folder).verify

    async def plain() -> Pipe:
        return Pipe(None, await asyncio.open_connection("127.0.0.1", ports[0], limit=2 << 20))

    async def secured() -> Pipe:
        opened = await asyncio.open_connection(
            "127.0.0.1", ports[1], limit=2 << 20, ssl=context, server_hostname=""
        )
        return Pipe(None, opened)

    async def rossec() -> Pipe:
        return Pipe(await connect("127.0.0.1", ports[2], SecureContext(own, verify)))

    async def hybrid() -> Pipe:
        suites = POST_QUANTUM["require"]
        return Pipe(await connect("127.0.0.1", ports[2], SecureContext(own, verify, suites=suites)))

    known = KnownCertificates()

    async def request_x5t() -> Pipe:
        return Pipe(await connect("127.0.0.1", ports[2], SecureContext(own, verify, known=known)))

    makers: Makers = {"plain": plain, "tls": secured, "rossec": rossec}
    pipes = {name: await make() for name, make in makers.items()}
    others = {"hybrid": hybrid, "x5t": request_x5t}
    await _round(pipes, makers, others, defaultdict(list))
    samples: Samples = defaultdict(list)
    end = time.monotonic() + seconds
    while not samples or time.monotonic() < end:
        await _round(pipes, makers, others, samples)
    for pipe in pipes.values():
        await pipe.close()
    return _report(samples, _handshake_bytes(folder))


async def _round(pipes: dict[str, Pipe], makers: Makers, others: Makers, samples: Samples) -> None:
    for size in SIZES:
        for name, pipe in pipes.items():
            samples[name, str(size)].append(await throughput(pipe, size))
    for size in SIZES[:2]:
        for name, pipe in pipes.items():
            samples[name, f"{size} paced"].append(await throughput(pipe, size, paced=True))
    for name, pipe in pipes.items():
        samples[name, "latency"].append(await latency(pipe))
    for _ in range(HANDSHAKE_SLICES):
        for name, make in makers.items():
            samples[name, "handshake"].append(await handshakes(make))
        for kind, make in others.items():
            samples["rossec", f"handshake {kind}"].append(await handshakes(make))


def _handshake_bytes(folder: Path) -> dict[str, int]:
    """What both sides send until the connection is open, openings and frames included."""
    memories = KnownCertificates(), KnownCertificates()
    return {
        "handshake_bytes_x5chain": _one_handshake(folder, *memories, (6,), request_x5t=False),
        "handshake_bytes_x5t": _one_handshake(folder, *memories, (6,), request_x5t=True),
        "handshake_bytes_hybrid": _one_handshake(folder, None, None, (HYBRID,), request_x5t=False),
    }


def _one_handshake(
    folder: Path,
    ours: KnownCertificates | None,
    theirs: KnownCertificates | None,
    suites: tuple[int, ...],
    *,
    request_x5t: bool,
) -> int:
    verify, now, random = _site.anchor(folder).verify, int(time.time()), secrets.token_bytes
    client, server = _site.credentials(folder, "client"), _site.credentials(folder, "server")
    calling = EdhocConfig(client, verify, random, suites, known=ours, request_x5t=request_x5t)
    left = Connection[Identity].initiator(calling, now=now)
    right = Connection[Identity].responder(EdhocConfig(server, verify, random, suites, known=theirs), now=now)
    total = 0
    for _ in range(2):
        for sender, receiver in ((left, right), (right, left)):
            data = sender.data_to_send()
            total += len(data)
            receive(receiver, data, now)
    return total


def _report(samples: Samples, sizes_on_the_wire: dict[str, int]) -> dict[str, object]:
    spread: dict[str, list[float]] = {}

    def ratio(other: str, what: str, ours: str = "") -> float:
        pairs = zip(samples[other, what], samples["rossec", ours or what], strict=True)
        ratios = [a / b for a, b in pairs]
        low, middle, high = quantiles(ratios, n=4) if len(ratios) > 1 else ratios * 3
        spread[f"{ours or what} vs {other}"] = [round(low, 2), round(high, 2)]
        return round(middle, 2)

    sizes = [str(size) for size in SIZES]
    return {
        "throughput_vs_tls": {size: ratio("tls", size) for size in sizes},
        "throughput_vs_plain": {size: ratio("plain", size) for size in sizes},
        "paced_vs_tls": {size: ratio("tls", f"{size} paced") for size in sizes[:2]},
        "latency_vs_tls": ratio("tls", "latency"),
        "handshake_rate_vs_tls": ratio("tls", "handshake"),
        "handshake_rate_vs_tls_hybrid": ratio("tls", "handshake", "handshake hybrid"),
        "handshake_rate_vs_tls_x5t": ratio("tls", "handshake", "handshake x5t"),
        **sizes_on_the_wire,
        "rounds": len(samples["rossec", "latency"]),
        "spread": spread,
        "median_microseconds": {
            name: {
                what: round(median(values) * 1e6, 2)
                for (there, what), values in samples.items()
                if there == name
            }
            for name in ("plain", "tls", "rossec")
        },
    }


def measure(seconds: float) -> dict[str, object]:
    """Measure for about `seconds`; at least one full round."""
    context = multiprocessing.get_context("spawn")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _site.build(folder)
        ports: Queue[tuple[int, int, int]] = context.Queue()
        process = context.Process(target=_server_process, args=(folder, ports), daemon=True)
        process.start()
        try:
            return asyncio.run(_measure(folder, ports.get(timeout=30), seconds))
        finally:
            process.terminate()
            process.join()
