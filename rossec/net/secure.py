"""`SecureStream`: what `connect` and `serve` hand out.

A *unit* is what one `send` was given; it arrives whole. Framing inside a unit is TCPROS's or
HTTP's own, and units queued by `send_nowait` may be joined into one: a receiver takes units as a
stream of bytes that never breaks inside what was sent together.
"""

import asyncio
from collections.abc import Iterator
from types import TracebackType
from typing import Final, Generic, Self

from rossec.channel.credentials import PeerT
from rossec.channel.opening import Flavour
from rossec.channel.records import Bytes
from rossec.errors import ChannelClosed, SendQueueFull
from rossec.net.driver import Driver

_QUEUE_LIMIT: Final = 1024 * 1024
_JOIN_LIMIT: Final = 64 * 1024


class SecureStream(Generic[PeerT]):
    """An authenticated connection. `peer` is who the certificate says it is."""

    def __init__(self, driver: Driver[PeerT], peer: PeerT) -> None:
        self.peer = peer
        self._driver = driver
        self._turn = asyncio.Lock()
        self._queue: list[bytes] = []
        self._queued = 0
        self._flush_due = False

    @property
    def address(self) -> str:
        """The peer's IP address: for logs, never for trust."""
        return self._driver.address

    @property
    def local_address(self) -> str:
        """This side's IP address, as the peer sees it unless there is NAT between."""
        return self._driver.local_address

    @property
    def opening(self) -> Flavour:
        """How the connection introduced itself: TCPROS or HTTP."""
        return self._driver.connection.flavour

    @property
    def backlog(self) -> int:
        """Bytes queued by `send_nowait` and not handed to the socket."""
        return self._queued

    async def send(self, *pieces: Bytes) -> None:
        """Send the pieces as one unit, after what is queued; waits while the peer lags.

        The pieces must not change until this returns. A `send` that is cancelled while it waits
        for the peer drops the connection: half a unit cannot be taken back.

        Raises:
            ChannelError: the connection is at its end.
            LimitExceeded: the unit is too long; the connection is untouched.
        """
        if len(pieces) == 1 and not self._queue and self._send_small(pieces[0]):
            return
        async with self._turn:
            await self._driver.drain()
            self._flush_queue()
            await self._write(self._driver.connection.seal_unit(*pieces))

    def _send_small(self, unit: Bytes) -> bool:
        """Send a unit of one record if nobody has to wait for anything."""
        driver = self._driver
        if self._turn.locked() or not driver.writable or not isinstance(unit, bytes):
            return False
        record = driver.connection.seal_small(unit)
        if record is None:
            return False
        driver.write(record)
        return True

    async def _write(self, records: Iterator[Bytes]) -> None:
        """Write each record as it is sealed: another one sealed meanwhile must come after it."""
        driver, done = self._driver, False
        try:
            for record in records:
                driver.write(record)
                if not driver.writable:
                    await driver.drain()
            done = True
        finally:
            if not done:
                driver.abort(ChannelClosed("a message was given up half-way"))

    def send_nowait(self, *pieces: Bytes) -> None:
        """Queue a small unit; what is queued together travels in one record.

        Raises:
            ChannelError: the connection is at its end.
            SendQueueFull: more than 1 MiB is queued already; nothing was added.
        """
        if self._driver.error is not None:
            raise self._driver.error
        if self._queued >= _QUEUE_LIMIT:
            raise SendQueueFull(
                "the peer does not read as fast as this side sends",
                "send less often, or drop old messages as ROS queues do",
            )
        unit = b"".join(pieces)
        self._queue.append(unit)
        self._queued += len(unit)
        if self._queued >= _JOIN_LIMIT:
            self._try_flush()
        elif not self._flush_due:
            self._flush_due = True
            asyncio.get_running_loop().call_soon(self._flush_soon)

    def _flush_soon(self) -> None:
        self._flush_due = False
        self._try_flush()

    def _try_flush(self) -> None:
        """Flush unless somebody else writes or the peer lags; then the next writer does."""
        if self._turn.locked() or self._driver.error is not None:
            return
        if self._driver.writable:
            self._flush_queue()
        elif not self._flush_due:
            self._flush_due = True
            self._driver.when_writable(self._flush_soon)

    def _flush_queue(self) -> None:
        if self._queue:
            queue, self._queue, self._queued = self._queue, [], 0
            for record in self._driver.connection.seal_unit(*queue):
                self._driver.write(record)

    async def receive(self) -> bytes:
        """Return the next unit.

        Raises:
            ChannelClosed: the connection was closed in order.
            ChannelError: it ended in another way; the leaf says how.
        """
        return await self._driver.receive()

    async def wait_ended(self) -> None:
        """Return when the connection is at its end, whoever ended it; takes no unit."""
        await self._driver.ended.wait()

    def abort(self, reason: str) -> None:
        """Cut the connection at once, for example because the peer's right was revoked."""
        self._driver.abort(ChannelClosed(reason))

    async def close(self) -> None:
        """Send what is queued, then close in order."""
        if self._driver.error is None and not self._turn.locked():
            self._flush_queue()
        await self._driver.close()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if kind is None:
            await self.close()
        else:
            self.abort("the user of the connection failed")
