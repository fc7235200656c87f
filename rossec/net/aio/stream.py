"""`SecureStream`: what `connect` and `serve` return.

A *unit* is the data of one `send`; it arrives whole. Framing inside a unit is TCPROS's or HTTP's
own, and small units sent in one burst are joined into one: a receiver takes units as a stream of
bytes that never breaks inside what was sent together.
"""

import asyncio
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from time import monotonic
from types import TracebackType
from typing import Final, Self

from rossec.channel.connection import Connection
from rossec.channel.edhoc.credentials import PeerT
from rossec.channel.records import Bytes
from rossec.errors import ChannelError
from rossec.net.aio.driver import Driver
from rossec.net.aio.transport import ByteTransport, TransportOwner

_JOIN_LIMIT: Final = 64 * 1024
_SMALL: Final = 32 * 1024  # below it joining beats a record of its own
_BURST: Final = 1 / 3  # of the time a record took: a turn of the loop takes longer, on any machine


class SecureStream(Driver[PeerT]):
    """An authenticated connection, as `Driver` with what is sent."""

    def __init__(
        self,
        connection: Connection[PeerT],
        transport: Callable[[TransportOwner], ByteTransport],
        address: str,
        on_authenticated: Callable[[Self], None],
        on_end: Callable[[Self, ChannelError], None],
    ) -> None:
        self._turn = asyncio.Lock()
        self._queue: list[bytes] = []
        self._queued = 0
        self._flush_due = False
        self._burst_until = 0.0
        self._limit = connection.unit_limit
        self._join = min(_JOIN_LIMIT, self._limit)
        self._small = min(_SMALL, self._limit)
        super().__init__(connection, transport, address, on_authenticated, on_end)

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
        size = _size(pieces)
        free = self.error is None and self.transport.writable and not self._turn.locked()
        if free and size < self._small:
            self._send_small(pieces, size)
            return
        async with self._turn:
            await self.drain()
            self._flush_queue()
            await self._write(self.connection.seal_unit(*pieces, reuse=True))

    async def _write(self, records: Iterator[Bytes]) -> None:
        """Write each record as it is sealed: another one sealed meanwhile must come after it."""
        done = False
        try:
            for record in records:
                self.write(record)
                if not self.transport.writable:
                    await self.drain()
            done = True
        finally:
            if not done:
                self.abort("a message was given up half-way")

    def _send_small(self, pieces: tuple[Bytes, ...], size: int) -> None:
        """Send a small unit at once, or queue it, to be flushed with others of its burst."""
        if size == 0:
            return
        piece = pieces[0] if len(pieces) == 1 else b"".join(pieces)
        unit = piece if isinstance(piece, bytes) else bytes(piece)
        if not self._queue and monotonic() > self._burst_until:
            self._write_now(unit)  # the first of a burst does not wait; the others are joined
            return
        if self._queued + size > self._join:
            self._try_flush()
        self._queue.append(unit)
        self._queued += size
        if not self._flush_due:
            self._flush_due = True
            self._loop.call_soon(self._flush_soon)

    def _flush_soon(self, _: object = None) -> None:
        self._flush_due = False
        with suppress(ChannelError):  # the connection has ended: its users get the error
            self._try_flush()

    def _try_flush(self) -> None:
        """Flush unless a write is in progress or the peer lags; then the next writer does."""
        if self._turn.locked() or self.error is not None:
            return
        if self.transport.writable:
            self._flush_queue()
        elif not self._flush_due:
            self._flush_due = True
            self._changed().add_done_callback(self._flush_soon)

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
        began = monotonic()
        try:
            record = self.connection.seal_small(unit)
            if record is not None:
                self.write(record)
            else:
                for each in self.connection.seal_unit(unit):
                    self.write(each)
        except ChannelError as error:
            self.fail(error)
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
        self.check()
        if self._queue:
            self._flush_queue()
        transport = self.transport
        small = self.connection.seal_small(data)
        if small is not None:
            transport.write(small)
        else:
            for record in self.connection.seal_unit(data, reuse=True):
                transport.write(record)
        return transport.writable

    def pad_units(self, multiple: int) -> None:
        """As of `Driver`; what is queued leaves as it was to be sent."""
        if self.error is None and not self._turn.locked():
            with suppress(ChannelError):  # the connection has ended: its users get the error
                self._flush_queue()
        super().pad_units(multiple)

    async def close(self) -> None:
        """Send what is queued, then close in order."""
        if self.error is None and not self._turn.locked():
            self._flush_queue()
        await self._close()

    def close_soon(self) -> None:
        """As `close`, without waiting for the peer: it may keep its end open for seconds."""
        if self.error is None and not self._turn.locked():
            self._flush_queue()
        self._begin_close()

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
