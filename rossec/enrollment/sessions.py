"""Frames of the enrollment on asyncio streams, and a port for them that is open to strangers.

A limited number of sessions are open at a time, in all and by address (`rossec.net.limits`).
"""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from typing import Final, TypeAlias

from ca.enrollment.messages import HEADER_SIZE, MAX_MESSAGE, frame, length
from rossec.host.runner import TaskSet
from rossec.net.aio.client import dial
from rossec.net.aio.server import bind
from rossec.net.limits import HalfOpenCount, HalfOpenLimits

CLOSE_TIMEOUT: Final = 5.0  # seconds for what was sent last to leave

Serve: TypeAlias = Callable[[asyncio.StreamReader, asyncio.StreamWriter, str], Awaitable[None]]
"""One session with the peer at an address, until it is over; it need not close the writer."""


async def receive(reader: asyncio.StreamReader) -> bytes:
    size = length(await reader.readexactly(HEADER_SIZE))
    return await reader.readexactly(size)


def send(writer: asyncio.StreamWriter, message: bytes) -> None:
    writer.write(frame(message))


@asynccontextmanager
async def connected(
    host: str, port: int, within: float
) -> AsyncIterator[tuple[asyncio.StreamReader, asyncio.StreamWriter]]:
    sock = await dial(host, port, within)
    try:
        reader, writer = await asyncio.open_connection(sock=sock, limit=MAX_MESSAGE)
    except BaseException:
        sock.close()
        raise
    try:
        yield reader, writer
    finally:
        writer.close()


class SessionServer:
    """Listens, and runs `serve` for every peer that `caps` admit."""

    def __init__(self, serve: Serve, caps: HalfOpenLimits) -> None:
        self.port = 0  # it listens on last
        self._serve = serve
        self._count = HalfOpenCount(caps)
        self._servers: list[asyncio.Server] = []
        self._tasks = TaskSet()

    def __len__(self) -> int:
        return len(self._count)

    async def listen(self, host: str | None, port: int) -> None:
        for sock in bind(host, port):
            server = await asyncio.start_server(self.accept, sock=sock, limit=MAX_MESSAGE)
            self._servers.append(server)
            self.port = sock.getsockname()[1]

    def stop_listening(self) -> None:
        for server in self._servers:
            server.close()

    async def close(self) -> None:
        self.stop_listening()
        await self._tasks.close()

    def accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        peer = writer.get_extra_info("peername")  # None: closed already
        address = "" if peer is None else str(peer[0])
        slot = None if peer is None else self._count.admit(address)
        if slot is None:
            writer.transport.abort()
            return

        async def session() -> None:
            slot.close = writer.transport.abort
            try:
                await self._serve(reader, writer, address)
                # It counts until its socket is closed, but is evicted first: idle sockets keep nobody out.
                slot.linger()
                writer.close()
                await wait_closed(writer)
            finally:
                writer.transport.abort()
                slot.release()

        self._tasks.spawn(session(), name=f"session with {address}")


async def wait_closed(writer: asyncio.StreamWriter) -> None:
    """Wait for what was sent last to leave, not forever."""
    with suppress(OSError, TimeoutError):
        async with asyncio.timeout(CLOSE_TIMEOUT):
            await writer.wait_closed()
