"""`SecureStream`: what `connect` and `serve` return.

A *unit* is the data of one `send`; it arrives whole. Framing inside a unit is TCPROS's or HTTP's
own, and small units sent in one burst are joined into one: a receiver takes units as a stream of
bytes that never breaks inside what was sent together.
"""

import asyncio
from collections.abc import Awaitable, Callable, Coroutine, Iterator, Sequence
from contextlib import suppress
from time import monotonic
from types import TracebackType
from typing import Any, Final, Generic, NoReturn, Self

from rossec.channel.edhoc.credentials import PeerT
from rossec.channel.opening import WireProtocol
from rossec.channel.records import Bytes
from rossec.errors import ChannelClosed, ChannelError, SendQueueFull
from rossec.net.aio.driver import Driver

_QUEUE_LIMIT: Final = 1024 * 1024
_JOIN_LIMIT: Final = 64 * 1024
_SMALL: Final = 32 * 1024  # below it joining beats a record of its own
_BURST: Final = 1 / 3  # of the time a record took: a turn of the loop takes longer, on any machine


class SecureStream(Generic[PeerT]):
    """An authenticated connection. `peer` is the identity of the certificate."""

    def __init__(self, driver: Driver[PeerT], peer: PeerT) -> None:
        self.peer = peer
        self._driver = driver
        self._loop = asyncio.get_running_loop()
        self._turn = asyncio.Lock()
        self._queue: list[bytes] = []
        self._queued = 0
        self._flush_due = False
        self._burst_until = 0.0
        self._limit = driver.connection.unit_limit
        self._join = min(_JOIN_LIMIT, self._limit)
        self._small = min(_SMALL, self._limit)

    @property
    def address(self) -> str:
        """The peer's IP address: for logs, never for trust."""
        return self._driver.address

    @property
    def local_address(self) -> str:
        """This side's IP address, as the peer sees it unless there is NAT between."""
        return self._driver.local_address

    @property
    def opening(self) -> WireProtocol:
        """The protocol in which the connection opened: TCPROS or HTTP."""
        return self._driver.connection.protocol

    @property
    def backlog(self) -> int:
        """Bytes of small units queued and not handed to the socket."""
        return self._queued

    @property
    def lags(self) -> bool:
        """Whether further writes would be buffered here."""
        return not self._driver.writable

    async def send(self, *pieces: Bytes) -> None:
        """Send the pieces as one unit, after what is queued; waits while the peer lags.

        A small unit leaves at once, unless it follows another one within a part of the time that
        one took to send: such a burst is joined in one record, which leaves at the end of this turn
        of the loop. A large one must not change until this returns; a `send` of one that is
        cancelled while it waits for the peer drops the connection, as half a unit was sent.

        Raises:
            ChannelError: the connection has ended.
            LimitExceeded: the unit is too long; the connection is untouched.
        """
        driver = self._driver
        size = _size(pieces)
        free = driver.error is None and driver.transport.writable and not self._turn.locked()
        if free and size < self._small:
            self._enqueue(pieces, size, now=True)
            return
        async with self._turn:
            await driver.drain()
            self._flush_queue()
            await self._write(driver.connection.seal_unit(*pieces, reuse=True))
            self._flush_queue()  # what came meanwhile

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
            ChannelError: the connection has ended.
            SendQueueFull: more than 1 MiB is queued already; nothing was added.
        """
        self._driver.check()
        if self._queued >= _QUEUE_LIMIT:
            raise SendQueueFull(
                "the peer does not read as fast as this side sends",
                "send less often, or drop old messages as ROS queues do",
            )
        self._driver.connection.check_unit(pieces)
        self._enqueue(pieces, _size(pieces), now=False)

    def _enqueue(self, pieces: tuple[Bytes, ...], size: int, *, now: bool) -> None:
        """Queue a small unit, to be flushed with others of its burst; or send it at once."""
        if size == 0:
            return
        piece = pieces[0] if len(pieces) == 1 else b"".join(pieces)
        unit = piece if isinstance(piece, bytes) else bytes(piece)
        if now and not self._queue and monotonic() > self._burst_until:
            self._write_now(unit)  # the first of a burst does not wait; the others are joined
            return
        if self._queued + size > self._join:
            self._try_flush()
        self._queue.append(unit)
        self._queued += size
        if not self._flush_due:
            self._flush_due = True
            self._loop.call_soon(self._flush_soon)

    def _flush_soon(self) -> None:
        self._flush_due = False
        with suppress(ChannelError):  # the connection has ended: its users get the error
            self._try_flush()

    def _try_flush(self) -> None:
        """Flush unless a write is in progress or the peer lags; then the next writer does."""
        if self._turn.locked() or self._driver.error is not None:
            return
        if self._driver.writable:
            self._flush_queue()
        elif not self._flush_due:
            self._flush_due = True
            self._driver.when_writable(self._flush_soon)

    def _flush_queue(self) -> None:
        if not self._queue:
            return
        queue, self._queue = self._queue, []
        units = queue if self._queued > self._limit else [b"".join(queue)]
        self._queued = 0
        for unit in units:
            self._write_now(unit)

    def _write_now(self, unit: bytes) -> None:
        """Send a record; what follows within a part of its time belongs to the same burst."""
        driver = self._driver
        began = monotonic()
        try:
            record = driver.connection.seal_small(unit)
            if record is not None:
                driver.write(record)
            else:
                for each in driver.connection.seal_unit(unit):
                    driver.write(each)
        except ChannelError as error:
            driver.fail(error)
            raise
        ended = monotonic()
        self._burst_until = ended + (ended - began) * _BURST

    def write_nowait(self, data: Bytes) -> bool:
        """Send `data` now, as one unit, even if the peer lags; false: it does, `drain`.

        For the only sender of a connection, which then waits: what the socket does not take is
        buffered without a limit.

        Raises:
            ChannelError: the connection has ended.
            LimitExceeded: the unit is too long; the connection is untouched.
        """
        driver = self._driver
        driver.check()
        if self._queue:
            self._flush_queue()
        transport = driver.transport
        small = driver.connection.seal_small(data)
        if small is not None:
            transport.write(small)
        else:
            for record in driver.connection.seal_unit(data, reuse=True):
                transport.write(record)
        return transport.writable

    def raise_unit_limit(self, limit: int | None = None) -> None:
        """Accept units of up to `limit`, or `ChannelLimits.unit`: the peer is authorized.

        Raises:
            ChannelError: the connection has ended.
        """
        self._driver.check()
        self._driver.connection.raise_unit_limit(limit)

    async def drain(self) -> None:
        """Wait until the peer caught up.

        Raises:
            ChannelError: the connection ended meanwhile.
        """
        await self._driver.drain()

    def forward(
        self, write_nowait: Callable[[bytes], bool], drain: Callable[[], Awaitable[None]]
    ) -> Coroutine[Any, Any, NoReturn]:
        """Pass each unit to `write_nowait` as it arrives; when it returns false, wait for `drain`.

        Raises:
            ChannelError: as `receive`; and whatever `write_nowait` and `drain` raise.
        """
        return self._driver.forward(write_nowait, drain)

    def try_send(self, unit: bytes) -> bool:
        """Send a unit now, unless units are queued or the peer lags.

        Returns whether it was sent; if not, use `send`.

        Raises:
            ChannelError: the connection has ended.
            LimitExceeded: the unit is too long; the connection is untouched.
        """
        driver = self._driver
        if self._queue or self._turn.locked() or not driver.transport.writable:
            return False
        driver.check()
        if len(unit) > self._small:
            driver.connection.check_unit((unit,))
        self._write_now(unit)
        return True

    def on_ready(
        self, callback: Callable[[], None] | None, take: Callable[[bytes], bool] | None = None
    ) -> None:
        """Call back whenever `next_unit` has a new result: instead of `receive`.

        A unit that arrived alone is offered to `take` first; if it returns true, it is not queued.
        Neither may raise.
        """
        self._driver.on_ready, self._driver.on_unit = callback, take

    @property
    def has_unit(self) -> bool:
        """Whether `next_unit` would return a unit."""
        return self._driver.has_unit

    def next_unit(self) -> bytes | None:
        """Return the next unit, if it has arrived.

        Raises:
            ChannelError: as `receive`.
        """
        return self._driver.take()

    def receive(self) -> Coroutine[Any, Any, bytes]:
        """Return the next unit.

        Raises:
            ChannelClosed: the connection was closed in order.
            ChannelError: it ended in another way; the class says how.
        """
        return self._driver.receive()

    def when_closed(self, callback: Callable[[], None]) -> None:
        """Call back, once, when the socket is closed: some time after the connection ended."""
        self._driver.when_closed(callback)

    async def wait_ended(self) -> None:
        """Return when the connection has ended; takes no unit."""
        await self._driver.wait_ended()

    def abort(self, reason: str) -> None:
        """Abort the connection at once, for example because the peer's grant was revoked."""
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


def _size(pieces: Sequence[Bytes]) -> int:
    """How many bytes the pieces have together."""
    total = 0
    for piece in pieces:
        total += piece.nbytes if isinstance(piece, memoryview) else len(piece)
    return total
