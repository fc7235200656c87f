"""Programs between two sites, as processes of their own: routers, the far side, a splice.

What the far side does is said before each message: a mode and how many bytes follow, which are sent
back (`ECHO`), or answered with one byte when all of them are there (`SINK`).
"""

import asyncio
import multiprocessing
import os
import signal
import socket
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import AsyncExitStack, ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Final, Protocol

from bench import _site
from ca.certificates import Identity
from rossec.errors import ChannelError
from rossec.net.aio import SecureContext, SecureStream, serve
from rossec.net.aio.client import dial
from rossec.overlay.documents import OPEN_ACCOUNT, Routers
from rossec.overlay.endpoint import LinkListener, dial_link, idle_round_trip
from rossec.overlay.link_frames import inbox
from rossec.overlay.mux import NODE, Role, StreamTarget
from rossec.overlay.router_settings import COMMON, client_settings
from rossec.overlay.streams import Pump, Streams
from rossec.overlay.zenoh_carrier import Carrier, open_session
from tests.support.contexts import unlimited
from tests.support.ports import free_port

ECHO: Final = b"E"
SINK: Final = b"S"
HEAD: Final = 9
ONE_ROUTER: Final = inbox(OPEN_ACCOUNT, bytes(16))
TWO_ROUTERS: Final = inbox(OPEN_ACCOUNT, bytes([1]) * 16)
RELAY: Final = inbox(OPEN_ACCOUNT, bytes([4]) * 16)
RAW: Final = inbox(OPEN_ACCOUNT, bytes([2]) * 16)
RAW_BACK: Final = inbox(OPEN_ACCOUNT, bytes([3]) * 16)


def head(mode: bytes, size: int) -> bytes:
    """What is said before `size` bytes."""
    return mode + size.to_bytes(8)


class Pipe(Protocol):
    """A connection of either kind."""

    async def send(self, *pieces: bytes) -> None:
        """Send the pieces."""
        ...

    async def receive(self) -> bytes:
        """Return what arrived."""
        ...


async def answer(pipe: Pipe) -> None:
    """Do what the peer says, for ever."""
    pending = b""
    while True:
        while len(pending) < HEAD:
            pending += await pipe.receive()
        mode, size = pending[:1], int.from_bytes(pending[1:HEAD])
        pieces = [pending[HEAD:]] if len(pending) > HEAD else []
        left = size - len(pending) + HEAD
        while left > 0:
            piece = await pipe.receive()
            left -= len(piece)
            if mode == ECHO:
                pieces.append(piece)
        pending = b""
        await (pipe.send(*pieces) if mode == ECHO else pipe.send(b"k"))


async def _secure(stream: SecureStream[Identity]) -> None:
    with suppress(ChannelError):
        await answer(stream)


class RawEcho:
    """The far side of raw Zenoh: in Zenoh's own thread, with nothing between."""

    def __init__(self, session: Any) -> None:
        import zenoh  # noqa: PLC0415 - with the extra only

        self._block = zenoh.CongestionControl.BLOCK
        self._session = session
        self._left = 0
        self._subscriber = session.declare_subscriber(RAW, self._receive)

    def _receive(self, sample: Any) -> None:
        data = sample.payload.to_bytes()
        if self._left == 0:
            if data[:1] == ECHO:
                self._session.put(RAW_BACK, data[HEAD:], congestion_control=self._block)
                return
            self._left = int.from_bytes(data[1:HEAD])
            return
        self._left -= len(data)
        if self._left <= 0:
            self._left = 0
            self._session.put(RAW_BACK, b"k", congestion_control=self._block)


@dataclass(frozen=True)
class Far:
    """What the far process is to do: sessions with one router each, or with all of `triangle`."""

    folder: Path
    near_router: str = ""
    far_router: str = ""
    triangle: tuple[str, ...] = ()


def context(folder: Path, name: str) -> SecureContext[Identity]:
    """The identity of a side, and whom it accepts: no limit of half-open connections."""
    return unlimited(_site.credentials(folder, name), _site.anchor(folder).verify)


def _far_process(far: Far, ready: Connection) -> None:
    async def main() -> None:
        own = context(far.folder, "server")
        async with AsyncExitStack() as stack:

            async def listen(key: str, *locators: str) -> None:
                carrier = await Carrier.open(Routers(locators, OPEN_ACCOUNT))
                stack.push_async_callback(carrier.close)
                await stack.enter_async_context(LinkListener(carrier, key, own, _secure))

            if far.triangle:
                await listen(ONE_ROUTER, *far.triangle)
                ready.send(0)
            else:
                await listen(ONE_ROUTER, far.near_router)
                await listen(TWO_ROUTERS, far.far_router)
                raw = open_session(client_settings(Routers((far.near_router,), OPEN_ACCOUNT)))
                echo = RawEcho(raw)
                ready.send(serve(_secure, "127.0.0.1", 0, own).port)
                del echo
            await asyncio.Event().wait()

    asyncio.run(main())


def _router_process(locator: str, joined: Sequence[str], ready: Connection) -> None:
    settings = {
        **COMMON,
        "mode": "router",
        "listen/endpoints": [locator],
        "connect/endpoints": list(joined),
        "connect/timeout_ms": -1,
        "connect/exit_on_failure": False,
    }
    session = open_session(settings)
    ready.send(0)
    threading.Event().wait()
    session.close()  # type: ignore[no-untyped-call]


def _called_relay_process(folder: Path, router: str, port: int, ready: Connection) -> None:
    """A relay that leads every stream to `port`, instead of asking a master."""

    async def dial_node(_target: StreamTarget, _pump: Pump) -> socket.socket:
        return await dial("127.0.0.1", port, 10)

    async def serve_streams(stream: SecureStream[Identity]) -> None:
        with suppress(ChannelError):
            round_trip = partial(idle_round_trip, stream)
            await Streams(stream, Role.CALLED, "near", dial_node, round_trip=round_trip).run()

    async def main() -> None:
        carrier = await Carrier.open(Routers((router,), OPEN_ACCOUNT))
        async with LinkListener(carrier, RELAY, context(folder, "server"), serve_streams):
            ready.send(0)
            await asyncio.Event().wait()

    asyncio.run(main())


def _calling_relay_process(folder: Path, router: str, ready: Connection) -> None:
    """A relay with one forwarded port, whose port it says."""

    async def main() -> None:
        carrier = await Carrier.open(Routers((router,), OPEN_ACCOUNT))
        link = await dial_link(carrier, RELAY, OPEN_ACCOUNT, context(folder, "client"))
        streams = Streams(link, Role.CALLER, "far", round_trip=partial(idle_round_trip, link))
        running = asyncio.ensure_future(streams.run())
        loop = asyncio.get_running_loop()
        with socket.create_server(("127.0.0.1", 0)) as forwarded_port:
            forwarded_port.setblocking(False)
            ready.send(forwarded_port.getsockname()[1])
            carried = []
            while not running.done():
                connection, _ = await loop.sock_accept(forwarded_port)
                carrying = streams.carry(StreamTarget(NODE, "/far"), connection)
                carried.append(asyncio.ensure_future(carrying))

    asyncio.run(main())


def _splice_process(port: int, ready: Connection) -> None:
    async def copy(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(ConnectionError):
            while data := await reader.read(256 * 1024):
                writer.write(data)
                await writer.drain()
        writer.close()

    async def splice(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        there = await asyncio.open_connection("127.0.0.1", port, limit=256 * 1024)
        await asyncio.gather(copy(reader, there[1]), copy(there[0], writer))

    async def main() -> None:
        server = await asyncio.start_server(splice, "127.0.0.1", 0, limit=256 * 1024)
        ready.send(server.sockets[0].getsockname()[1])
        await server.serve_forever()

    asyncio.run(main())


class Programs:
    """The processes of one measurement; all of them end with it."""

    def __init__(self) -> None:
        self._context = multiprocessing.get_context("spawn")
        self._stack = ExitStack()
        folder = self._stack.enter_context(tempfile.TemporaryDirectory())
        self.folder = Path(folder)
        self.routers: dict[str, int] = {}
        _site.build(self.folder)

    def _start(self, target: Callable[..., None], *arguments: object) -> tuple[int, int]:
        """Start a process; returns what it says when it is ready, and its number."""
        ours, theirs = self._context.Pipe()
        process = self._context.Process(target=target, args=(*arguments, theirs), daemon=True)
        process.start()
        self._stack.callback(process.join)
        self._stack.callback(process.kill)
        if not ours.poll(30):
            raise RuntimeError("a process of the benchmark does not start")
        assert process.pid is not None
        said: int = ours.recv()
        return said, process.pid

    def router(self, *joined: str) -> str:
        """A router, joined with others; its locator."""
        locator = f"tcp/127.0.0.1:{free_port()}"
        self.routers[locator] = self._start(_router_process, locator, joined)[1]
        return locator

    def far(self, near_router: str = "", far_router: str = "", *triangle: str) -> int:
        """The far side; its port for connections without an overlay."""
        return self._start(_far_process, Far(self.folder, near_router, far_router, triangle))[0]

    def relays(self, router: str, port: int) -> int:
        """Two relays, and a router between, on the way to `port`; the forwarded port's port."""
        self._start(_called_relay_process, self.folder, router, port)
        return self._start(_calling_relay_process, self.folder, router)[0]

    def splice(self, port: int) -> int:
        """A program that passes bytes on to `port`; its own port."""
        return self._start(_splice_process, port)[0]

    def signal_router(self, locator: str, number: signal.Signals) -> None:
        """Send a signal to a router."""
        os.kill(self.routers[locator], number)

    def close(self) -> None:
        """End them all."""
        self._stack.close()


@contextmanager
def programs() -> Iterator[Programs]:
    """Processes that end with the block."""
    made = Programs()
    try:
        yield made
    finally:
        made.close()
