"""The streams of one link at work: a `Mux` on a secure stream, a `Pump` for each connection.

What arrives for a stream is written to its connection at once, and never waited for: a connection that
lags gets no credit, and the others go on. What is malformed ends the link, with all that it carried.
"""

import asyncio
import logging
import socket
import time
from collections.abc import Awaitable, Callable
from typing import Any, Final, TypeAlias, TypeVar

from ca.errors import HintedError
from rossec.channel.records import Bytes
from rossec.errors import ChannelError, LinkCrowded, StreamRefused
from rossec.host.runner import TaskSet
from rossec.net.aio.stream import SecureStream
from rossec.net.aio.transport import Transport
from rossec.overlay import mux
from rossec.participant import delivery_options

_KEEPALIVE: Final = (
    (socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1),
    (socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, 60),  # a host that vanished must not hold a stream
    (socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, 15),
)
Found = TypeVar("Found")
CONNECT_SECONDS: Final = 10.0  # to find and reach a target; also how long a connection waits for room
MOST_WAITING: Final = 256  # connections that wait for room
MOST_UNSENT: Final = 8 * 1024 * 1024  # twice a link's window: the peer reads nothing, but asks
_CROWDED: Final = "it has too many streams"
_FEWER: Final = (
    f"a link carries {mux.STREAMS} connections, {mux.FOR_ONE_NAME} to one name and {mux.YOUNG} new ones at a "
    "time: nodes try again, or let one subscribe from there and publish for the others"
)
_log = logging.getLogger("rossec.overlay")


class Pump:
    """One TCP connection of this site and its stream of a link: bytes both ways, ends as ends.

    Bytes for a program that lags wait here, no more of them than the credit given.
    """

    def __init__(self, stream: int, end: "Streams") -> None:
        self._stream, self._end = stream, end
        self._transport: Transport | None = None
        self._early = bytearray()  # what arrived before there was a socket
        self._early_end = False
        self._read_all = False  # the program sends nothing more
        self._changed = asyncio.Event()
        self._held = 0  # received bytes the program has not taken
        self.over: Final = asyncio.Event()

    @property
    def connected(self) -> bool:
        return self._transport is not None

    def connect(self, sock: socket.socket) -> None:
        if self.over.is_set():
            sock.close()
            return
        for option in _KEEPALIVE:
            sock.setsockopt(*option)
        self._transport = Transport(sock, self)
        early, self._early = self._early, bytearray()
        if early:
            self._write(early, self._transport)
        if self._early_end:
            self._transport.write_eof()
        self._transport.resume_reading()

    async def first_bytes(self, decide: Callable[[bytes], Found | None]) -> Found:
        while (found := decide(bytes(self._early))) is None:
            if self._early_end or self.over.is_set():
                raise StreamRefused("a stream that ended before it said anything")
            self._changed.clear()
            await self._changed.wait()
        return found

    # -- called for the stream

    def arrived(self, payload: Bytes) -> None:
        self._held += len(payload)
        if self._transport is None:
            self._early += payload
            self._changed.set()
        else:
            self._write(payload, self._transport)

    def _write(self, payload: Bytes, transport: Transport) -> None:
        transport.write(payload)
        self._account(transport)

    def _account(self, transport: Transport) -> None:
        taken = self._held - transport.backlog
        if taken > 0:
            self._held -= taken
            self._end.took(self._stream, taken)

    def ended(self, *, over: bool) -> None:
        self._early_end = True
        self._changed.set()
        if self._transport is not None:
            self._transport.write_eof()
            if over:
                self._transport.finish()

    def resume(self) -> None:
        if self._transport is not None and not self._read_all:
            self._transport.resume_reading()
            self._transport.read_now()

    def break_off(self) -> None:
        if self._transport is None:
            self.connection_lost()
        else:
            self._transport.reset()

    # -- called by the transport

    def get_buffer(self) -> memoryview:
        # No queue: the socket is read when the stream has credit and the link has room, straight into the
        # buffer from which the unit is sealed.
        buffer = self._end.buffer_for(self._stream)
        if buffer is None:
            if self._transport is not None:
                self._transport.pause_reading()
            raise BlockingIOError
        return buffer

    def buffer_updated(self, count: int) -> None:
        self._end.send(self._stream, count)

    def eof_received(self) -> bool:
        self._read_all = True
        return self._end.end(self._stream)

    def resume_writing(self) -> None:
        if self._transport is not None:
            self._account(self._transport)

    def connection_lost(self) -> None:
        self._end.reset(self._stream)
        self.over.set()
        self._changed.set()


Dial: TypeAlias = Callable[[mux.StreamTarget, Pump], Awaitable[socket.socket]]
"""Connects to a target. Raises a `HintedError` or an `OSError`."""


async def refuse_streams(target: mux.StreamTarget, _pump: Pump) -> socket.socket:
    raise StreamRefused(f"a stream to {target} where none is opened")


class Streams:
    """One side of the streams of a link.

    Args:
        link: authenticated; this is its only user.
        peer: the label of the relay at the other end, for the log.
        dial: connects the called side to targets.
        round_trip: of the link when it is idle, in seconds; 0 if that is not known.
    """

    def __init__(
        self,
        link: SecureStream[Any],
        role: mux.Role,
        peer: str,
        dial: Dial = refuse_streams,
        clock: Callable[[], float] = time.monotonic,
        *,
        round_trip: Callable[[], float] = float,
    ) -> None:
        self._link, self._peer, self._dial = link, peer, dial
        self._clock, self._round_trip = clock, round_trip
        self._mux = mux.Mux(role)
        self._pumps: dict[int, Pump] = {}
        self._buffer = memoryview(bytearray(mux.HEADROOM + mux.MAX_DATA))
        self._waiting: dict[int, None] = {}  # read when the link has room, in this order
        self._draining = False
        self._openers: set[asyncio.Future[None]] = set()
        self._tasks = TaskSet()
        self._over: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self.idle_since: float | None = clock()

    def __len__(self) -> int:
        return len(self._mux)

    @property
    def used_up(self) -> bool:
        return self._mux.used_up or self._over.done()

    async def run(self) -> None:
        try:
            self._link.on_ready(self._ready, self._take)
            self._ready()
            await self._over
        finally:
            self._link.on_ready(None)
            self._fail(StreamRefused("the link is closed"))
            self._link.abort("the streams of the link are closed")
            for pump in tuple(self._pumps.values()):
                pump.break_off()
            await self._tasks.close()

    # -- the caller's side

    async def carry(self, target: mux.StreamTarget, sock: socket.socket) -> None:
        try:
            async with asyncio.timeout(CONNECT_SECONDS):
                await self._room_for(target)
            number, unit = self._mux.open(target, self._clock())
        except TimeoutError as error:
            sock.close()
            why = self._mux.crowded(target, self._clock())
            raise LinkCrowded(f"no room for {target} at {self._peer}: {why}", _FEWER) from error
        except BaseException:
            sock.close()
            raise
        pump = self._add(number)
        self._write(unit)
        pump.connect(sock)
        try:
            await pump.over.wait()
        finally:
            pump.break_off()

    async def _room_for(self, target: mux.StreamTarget) -> None:
        if len(self._openers) >= MOST_WAITING:
            raise LinkCrowded(f"too many connections wait for {self._peer}", _FEWER)
        while not self._over.done() and self._mux.crowded(target, self._clock()):
            opener = asyncio.get_running_loop().create_future()
            self._openers.add(opener)
            try:
                await asyncio.wait((opener,), timeout=1.0)  # a stream may just have grown old
            finally:
                self._openers.discard(opener)
        if self._over.done():
            raise StreamRefused(f"the link to {self._peer} has ended")

    def _wake_openers(self) -> None:
        for opener in self._openers:
            if not opener.done():
                opener.set_result(None)

    # -- the called side

    async def _connect(self, number: int, pump: Pump, target: mux.StreamTarget) -> None:
        try:
            async with asyncio.timeout(CONNECT_SECONDS):
                sock = await self._dial(target, pump)
            pump.connect(sock)
        except (HintedError, OSError, TimeoutError) as error:
            delivery_options.warn(_log, delivery_options.REFUSED, str(target), self._peer, error)
        finally:
            self._mux.connected(number)
            if not pump.connected:
                pump.break_off()

    # -- from the link

    def _ready(self) -> None:
        try:
            while (unit := self._link.next_unit()) is not None:
                self._take(unit)
        except ChannelError as error:
            self._fail(error)

    def _take(self, unit: bytes) -> bool:
        if self._over.done():
            return True
        try:
            for event in self._mux.receive(unit, self._clock()):
                self._handle(event)
        except BaseException as error:
            self._fail(error)
            if not isinstance(error, StreamRefused | ChannelError):
                raise
        if self._openers:
            self._wake_openers()
        return True

    def _handle(self, event: mux.Event) -> None:
        match event:
            case mux.StreamOpened(number, target):
                self._tasks.spawn(self._connect(number, self._add(number), target), str(target))
            case mux.OpeningRefused(_, target, reply):
                delivery_options.warn(_log, delivery_options.REFUSED, str(target), self._peer, _CROWDED)
                self._write(reply)
            case mux.Data(stream, payload) if pump := self._pumps.get(stream):
                pump.arrived(payload)
            case mux.Credit(stream) if pump := self._pumps.get(stream):
                pump.resume()
            case mux.End(stream) if pump := self._pumps.get(stream):
                pump.ended(over=stream not in self._mux)
            case mux.Reset(stream) if pump := self._pumps.get(stream):
                pump.break_off()
            case _:  # its connection is over
                pass

    def _add(self, number: int) -> Pump:
        self.idle_since = None
        pump = self._pumps[number] = Pump(number, self)
        return pump

    # -- from pumps

    def buffer_for(self, stream: int) -> memoryview | None:
        if self._draining:
            self._waiting[stream] = None
            return None
        room = min(self._mux.credit(stream), mux.MAX_DATA)
        return self._buffer[mux.HEADROOM : mux.HEADROOM + room] if room else None

    def send(self, stream: int, count: int) -> None:
        # The head is written in front of the payload, which is not copied.
        head = self._mux.data(stream, count)
        begin = mux.HEADROOM - len(head)
        self._buffer[begin : mux.HEADROOM] = head
        self._write(self._buffer[begin : mux.HEADROOM + count])

    def took(self, stream: int, count: int) -> None:
        self._write(self._mux.took(stream, count, self._clock(), self._round_trip()))

    def end(self, stream: int) -> bool:
        self._write(self._mux.end(stream))
        return stream in self._mux

    def reset(self, stream: int) -> None:
        if self._pumps.pop(stream, None) is None:
            return
        self._write(self._mux.reset(stream))
        if not self._pumps:
            self.idle_since = self._clock()
        self._wake_openers()

    # -- to the link

    def _write(self, unit: Bytes) -> None:
        # Send a unit; only small ones are written while the link lags.
        if not unit or self._over.done():
            return
        try:
            writable = self._link.write_nowait(unit)
        except ChannelError as error:
            self._fail(error)
            return
        # While the link lags no connection is read; answers to a peer that asks without reading have their
        # end.
        if not writable and not self._draining:
            self._draining = True
            self._tasks.spawn(self._drain(), "a link that lags")
        elif not writable and self._link.backlog > MOST_UNSENT:
            self._fail(StreamRefused("the peer asks without reading"))

    async def _drain(self) -> None:
        try:
            await self._link.drain()
        except ChannelError as error:
            self._fail(error)
            return
        # Each that had to wait is read once, in the order in which they came.
        self._draining = False
        for stream in tuple(self._waiting):
            if self._draining:  # again; the others keep their turn
                return
            del self._waiting[stream]
            if stream in self._pumps:
                self._pumps[stream].resume()

    def _fail(self, error: BaseException) -> None:
        if not self._over.done():
            self._over.set_exception(error)
            self._over.exception()  # whoever runs this gets it; nobody else has to
            self._link.abort("a rule of the streams was broken")
