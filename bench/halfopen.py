"""10,000 half-open connections against a server that has work to do.

The server and its one client run in processes of their own; this one opens connections that never
finish their handshake, from addresses of 127/8 (100 sources), and keeps open whatever the server
keeps. Wanted: the established connection keeps half its rate, the server's memory grows by less
than 64 MiB, and a newcomer is served once the flood is over.
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
from pathlib import Path
from statistics import median

from bench import _site
from ca.certificates import Identity
from rossec.errors import ChannelError
from rossec.net.stream import SecureStream, connect, serve

COUNT = 10_000
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
        async with await serve(echo, "127.0.0.1", 0, own, _site.anchor(folder).verify) as server:
            ports.put(server.port)
            await asyncio.Event().wait()

    asyncio.run(main())


def _client(folder: Path, port: int, seconds: float, rates: "Queue[list[float]]") -> None:
    """Count round trips in slices of a tenth of a second."""

    async def main() -> list[float]:
        own = _site.credentials(folder, "client")
        stream = await connect("127.0.0.1", port, own, _site.anchor(folder).verify)
        slices, end = [], time.monotonic() + seconds
        while time.monotonic() < end:
            count, begin = 0, time.monotonic()
            while time.monotonic() < begin + 0.1:
                await stream.send(bytes(64))
                await stream.receive()
                count += 1
            slices.append(count / (time.monotonic() - begin))
        await stream.close()
        return slices

    rates.put(asyncio.run(main()))


def _lift_descriptors() -> None:
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))


def _memory(pid: int) -> int:
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * _PAGE


def _flood(port: int, seconds: float) -> list[socket.socket]:
    """Open `COUNT` connections evenly over `seconds`; each sends the opening and then nothing."""
    held: list[socket.socket] = []
    begin = time.monotonic()
    for number in range(COUNT):
        sock = socket.socket()
        sock.bind((f"127.1.{number % 100}.1", 0))
        with suppress(OSError):
            sock.connect(("127.0.0.1", port))
            sock.send(_OPENING)
        held.append(sock)
        ahead = begin + seconds * number / COUNT - time.monotonic()
        if ahead > 0.01:
            time.sleep(ahead)
    return held


async def _newcomer(folder: Path, port: int) -> float:
    """Seconds until somebody new is served."""
    own, begin = _site.credentials(folder, "client"), time.monotonic()
    while True:
        try:
            async with await connect("127.0.0.1", port, own, _site.anchor(folder).verify) as stream:
                await stream.send(b"x")
                await stream.receive()
                return time.monotonic() - begin
        except ChannelError:
            await asyncio.sleep(0.1)


def measure(seconds: float) -> dict[str, object]:
    """Measure for about `seconds`: a third in peace, the rest under the flood."""
    _lift_descriptors()
    context = multiprocessing.get_context("spawn")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _site.build(folder)
        ports: Queue[int] = context.Queue()
        rates: Queue[list[float]] = context.Queue()
        server = context.Process(target=_server, args=(folder, ports), daemon=True)
        server.start()
        port = ports.get(timeout=30)
        client = context.Process(target=_client, args=(folder, port, seconds, rates), daemon=True)
        client.start()
        try:
            time.sleep(seconds / 3)
            before = _memory(server.pid or 0)
            held = _flood(port, seconds * 2 / 3)
            grown = _memory(server.pid or 0) - before
            slices = rates.get(timeout=60)
            waited = asyncio.run(_newcomer(folder, port))
            for sock in held:
                sock.close()
        finally:
            for process in (client, server):
                process.terminate()
                process.join()
    peace = median(slices[2 : len(slices) // 3 - 2])
    flood = median(slices[len(slices) // 3 + 2 :])
    return {
        "half_open": COUNT,
        "rate_before": round(peace),
        "rate_during": round(flood),
        "rate_kept": round(flood / peace, 2),
        "memory_grown_mib": round(grown / 2**20, 1),
        "newcomer_served_after_s": round(waited, 2),
    }
