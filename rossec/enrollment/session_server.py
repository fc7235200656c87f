"""A port that is open to strangers: a limited number of sessions at a time, in all and by address.

A session counts until its socket is closed. One that has ended and whose peer does not close is
evicted first, so that idle sockets keep nobody out (`rossec.net.halfopen`).
"""

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Final, TypeAlias

from ca.enrollment.messages import MAX_MESSAGE
from rossec.net.aio.server import bind
from rossec.net.aio.tasks import TaskSet
from rossec.net.halfopen import HalfOpen, HalfOpenCount, HalfOpenSlot

CLOSE_TIMEOUT: Final = 5.0  # seconds for what was sent last to leave

Serve: TypeAlias = Callable[[asyncio.StreamReader, asyncio.StreamWriter, str], Awaitable[None]]
"""One session with the peer at an address, until it is over; it need not close the writer."""


class SessionServer:
    """Listens, and runs `serve` for every peer that `caps` admit.

    Attributes:
        port: the port it listens on last; 0 before.
    """

    def __init__(self, serve: Serve, caps: HalfOpen) -> None:
        self.port = 0
        self._serve = serve
        self._count = HalfOpenCount(caps)
        self._servers: list[asyncio.Server] = []
        self._tasks = TaskSet()

    def __len__(self) -> int:
        """The number of open sessions."""
        return len(self._count)

    async def listen(self, host: str | None, port: int) -> None:
        """Serve on `host` (None: every address) and `port` (0: any free one).

        Raises:
            OSError: not an address of this host, or the port is taken.
        """
        for sock in bind(host, port):
            server = await asyncio.start_server(self.accept, sock=sock, limit=MAX_MESSAGE)
            self._servers.append(server)
            self.port = sock.getsockname()[1]

    def stop_listening(self) -> None:
        """Admit nobody more; open sessions go on."""
        for server in self._servers:
            server.close()

    async def close(self) -> None:
        """Stop listening, and end the open sessions."""
        self.stop_listening()
        await self._tasks.close()

    def accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Admit a peer that has connected, or close its connection at once."""
        peer = writer.get_extra_info("peername")  # None: closed already
        address = "" if peer is None else str(peer[0])
        slot = None if peer is None else self._count.admit(address)
        if slot is None:
            writer.transport.abort()
            return
        session = self._run(reader, writer, address, slot)
        self._tasks.spawn(session, name=f"session with {address}")

    async def _run(
        self,
        reader: asyncio.StreamReader,
        writer: asyncio.StreamWriter,
        address: str,
        slot: HalfOpenSlot,
    ) -> None:
        slot.close = writer.transport.abort
        try:
            await self._serve(reader, writer, address)
            slot.linger()
            writer.close()
            await wait_closed(writer)
        finally:
            writer.transport.abort()
            slot.release()


async def wait_closed(writer: asyncio.StreamWriter) -> None:
    """Wait for what was sent last to leave, not forever."""
    with suppress(OSError, TimeoutError):
        async with asyncio.timeout(CLOSE_TIMEOUT):
            await writer.wait_closed()
