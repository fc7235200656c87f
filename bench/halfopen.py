"""10,000 half-open connections against a server that has work to do.

The server and its one client run in processes of their own; this one opens connections that never
finish their handshake, from addresses of 127/8 (100 sources), and keeps open whatever the server
keeps. It floods in waves, and what is compared are neighbours: a wave and the pause after it, so
that other load hits both. It has a low priority, because a real attacker has its own computer.
Wanted: the established connection keeps half its rate, the server's memory grows by less than
64 MiB, and a newcomer is served once the flood is over.
"""

import asyncio
import multiprocessing
import os
import resource
import socket
import tempfile
import time
from contextlib import suppress
from multiprocessing.queues import Queue
from multiprocessing.synchronize import Event
from pathlib import Path
from statistics import median
from typing import TypeAlias

from bench import _site
from ca.certificates import Identity
from rossec.errors import ChannelError
from rossec.net.aio import SecureContext, SecureStream, connect, serve

COUNT = 10_000
WAVES = 10
SLICE = 0.05  # seconds
Slice: TypeAlias = tuple[float, float]  # when it began, round trips a second
_OPENING = bytes.fromhex("0c000000080000") + b"\0rossec=1"
_PAGE = os.sysconf("SC_PAGE_SIZE")


def _server(folder: Path, ports: "Queue[int]") -> None:
    _lift_descriptors()

    async def echo(stream: SecureStream[Identity]) -> None:
        with suppress(ChannelError):
            while True:
                await stream.send(await stream.receive())

    async def main() -> None:
        own = _site.credentials(folder, "server")
        async with serve(echo, "127.0.0.1", 0, SecureContext(own, _site.anchor(folder).verify)) as server:
            ports.put(server.port)
            await asyncio.Event().wait()

    asyncio.run(main())


def _client(folder: Path, port: int, done: Event, rates: "Queue[list[Slice]]") -> None:
    """Count round trips in slices of a twentieth of a second, until it is stopped."""

    async def main() -> list[Slice]:
        own = _site.credentials(folder, "client")
        stream = await connect("127.0.0.1", port, SecureContext(own, _site.anchor(folder).verify))
        slices = []
        while not done.is_set():
            count, begin = 0, time.monotonic()
            while time.monotonic() < begin + SLICE:
                await stream.send(bytes(64))
                await stream.receive()
                count += 1
            slices.append((begin, count / (time.monotonic() - begin)))
        await stream.close()
        return slices

    rates.put(asyncio.run(main()))


def _lift_descriptors() -> None:
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))


def _memory(pid: int) -> int:
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * _PAGE


def _flood(port: int, seconds: float) -> tuple[list[socket.socket], list[tuple[float, float]]]:
    """Open `COUNT` connections in waves over `seconds`; return them, and when each wave ran."""
    held: list[socket.socket] = []
    waves: list[tuple[float, float]] = []
    wave = seconds / WAVES / 2
    for _ in range(WAVES):
        begin = time.monotonic()
        held += _wave(port, wave)
        waves.append((begin, time.monotonic()))
        time.sleep(wave)
    return held, waves


def _wave(port: int, seconds: float) -> list[socket.socket]:
    """Connections evenly over `seconds`; each sends the opening and then nothing."""
    held: list[socket.socket] = []
    begin = time.monotonic()
    count = COUNT // WAVES
    for number in range(count):
        sock = socket.socket()
        sock.bind((f"127.1.{number % 100}.1", 0))
        with suppress(OSError):
            sock.connect(("127.0.0.1", port))
            sock.send(_OPENING)
        held.append(sock)
        ahead = begin + seconds * number / count - time.monotonic()
        if ahead > 0.01:
            time.sleep(ahead)
    return held


def _wave_and_pause(slices: list[Slice], begin: float, end: float) -> tuple[float, float]:
    """The rates during a wave and in the pause of the same length after it."""
    during = [rate for at, rate in slices if begin <= at < end - SLICE]
    after = [rate for at, rate in slices if end <= at < end + (end - begin) - SLICE]
    return median(during), median(after)


async def _newcomer(folder: Path, port: int) -> float:
    """Seconds until a new caller is served."""
    own, begin = _site.credentials(folder, "client"), time.monotonic()
    while True:
        try:
            async with await connect(
                "127.0.0.1", port, SecureContext(own, _site.anchor(folder).verify)
            ) as stream:
                await stream.send(b"x")
                await stream.receive()
                return time.monotonic() - begin
        except ChannelError:
            await asyncio.sleep(0.1)


def measure(seconds: float) -> dict[str, object]:
    """Measure for about `seconds`: a fifth in peace, the rest in waves of the flood."""
    _lift_descriptors()
    context = multiprocessing.get_context("spawn")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _site.build(folder)
        ports: Queue[int] = context.Queue()
        rates: Queue[list[Slice]] = context.Queue()
        done = context.Event()
        server = context.Process(target=_server, args=(folder, ports), daemon=True)
        server.start()
        port = ports.get(timeout=30)
        client = context.Process(target=_client, args=(folder, port, done, rates), daemon=True)
        client.start()
        try:
            time.sleep(seconds / 5)
            before = _memory(server.pid or 0)
            os.nice(10)
            held, waves = _flood(port, seconds * 4 / 5)
            grown = _memory(server.pid or 0) - before
            done.set()
            slices = rates.get(timeout=60)
            waited = asyncio.run(_newcomer(folder, port))
            for sock in held:
                sock.close()
        finally:
            for process in (client, server):
                process.terminate()
                process.join()
    peace = median(rate for begin, rate in slices if begin + SLICE < waves[0][0])
    pairs = [_wave_and_pause(slices, *wave) for wave in waves]
    return {
        "half_open": COUNT,
        "rate_before": round(peace),
        "rate_during": round(median(during for during, _ in pairs)),
        "rate_kept": round(median(during / pause for during, pause in pairs), 2),
        "rate_kept_of_before": round(median(during for during, _ in pairs) / peace, 2),
        "memory_grown_mib": round(grown / 2**20, 1),
        "newcomer_served_after_s": round(waited, 2),
    }
