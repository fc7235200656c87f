"""Two relays without names and masters: the streams of one link over a real secure stream."""

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import dataclass

from rossec.channel.opening import WireProtocol
from rossec.net.aio import SecureStream, connect, serve
from rossec.net.aio.client import dial
from rossec.overlay.mux import NODE, Role, StreamTarget
from rossec.overlay.streams import Dial, Pump, Streams
from tests.support.contexts import context
from tests.support.wire import ALICE, BOB, FakeIdentity

ROBOT = StreamTarget(NODE, "/robot")
Ends = tuple[asyncio.StreamReader, asyncio.StreamWriter]


@dataclass
class Link:
    """The streams of both sides, what they run on, and how each ended."""

    near: SecureStream[FakeIdentity]
    far: SecureStream[FakeIdentity]

    caller: Streams
    called: Streams
    ends: list[BaseException]
    runs: list[asyncio.Task[None]]

    async def ended(self) -> list[BaseException]:
        """How both sides ended."""
        async with asyncio.timeout(30):
            await asyncio.gather(*self.runs)
        return self.ends


@contextlib.asynccontextmanager
async def secure_pair() -> AsyncIterator[tuple[SecureStream[FakeIdentity], SecureStream[FakeIdentity]]]:
    """Both ends of a secure stream, the one that dialled first."""
    accepted: asyncio.Future[SecureStream[FakeIdentity]] = asyncio.get_running_loop().create_future()

    async def keep(stream: SecureStream[FakeIdentity]) -> None:
        accepted.set_result(stream)
        await stream.wait_ended()

    async with serve(keep, "127.0.0.1", 0, context(BOB), WireProtocol.HTTP) as server:
        dialled = await connect("127.0.0.1", server.port, context(ALICE), WireProtocol.HTTP)
        try:
            yield dialled, await accepted
        finally:
            dialled.abort("the test is over")


@contextlib.asynccontextmanager
async def linked(dial_target: Dial) -> AsyncIterator[Link]:
    """A link whose called side connects streams by `dial_target`."""
    ends: list[BaseException] = []

    async def run(streams: Streams) -> None:
        try:
            await streams.run()
        except Exception as error:  # noqa: BLE001 - the test looks at it
            ends.append(error)

    async with secure_pair() as (near, far):
        caller = Streams(near, Role.CALLER, "hospital")
        called = Streams(far, Role.CALLED, "home", dial_target)
        runs = [asyncio.ensure_future(run(each)) for each in (caller, called)]
        try:
            yield Link(near, far, caller, called, ends, runs)
        finally:
            for task in runs:
                task.cancel()
            await asyncio.gather(*runs, return_exceptions=True)


def to_port(port: int) -> Dial:
    """Connects every stream to this port of loopback."""

    async def dial_target(_target: StreamTarget, _pump: Pump) -> socket.socket:
        return await dial("127.0.0.1", port, 10)

    return dial_target


@contextlib.asynccontextmanager
async def program(
    serve_one: Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]],
) -> AsyncIterator[int]:
    """A plain TCP server; its port."""

    async def handle(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(OSError, asyncio.IncompleteReadError):
            await serve_one(reader, writer)
        writer.close()

    server = await asyncio.start_server(handle, "127.0.0.1", 0)
    async with server:
        yield server.sockets[0].getsockname()[1]


async def echo(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Send back everything, then end."""
    while data := await reader.read(1 << 16):
        writer.write(data)
        await writer.drain()
    writer.write_eof()


async def tcp_pair() -> tuple[socket.socket, socket.socket]:
    """Both ends of a TCP connection on loopback."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        near = socket.create_connection(server.getsockname())
        far, _ = server.accept()
    near.setblocking(False)
    far.setblocking(False)
    return near, far


@contextlib.asynccontextmanager
async def carried(streams: Streams, target: StreamTarget = ROBOT) -> AsyncIterator[Ends]:
    """A connection that a stream carries: what a program holds that went through a forwarded port."""
    mine, theirs = await tcp_pair()
    task = asyncio.ensure_future(streams.carry(target, theirs))
    reader, writer = await asyncio.open_connection(sock=mine)
    try:
        yield reader, writer
    finally:
        writer.close()
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
