"""The streams of one link at work: a `Mux` on a secure stream, a `Pump` for each connection.

What arrives for a stream is written to its connection at once, and never waited for: a connection
that lags gets no credit, and the others go on. While the link itself lags, connections are not
read; afterwards each is read once, in the order in which they had to wait. What is malformed ends
the link, and with it every connection it carried.
"""

import asyncio
import logging
import socket
import time
from collections.abc import Awaitable, Callable
from typing import Final, Protocol, TypeAlias

from ca.errors import HintedError
from rossec.channel.records import Bytes
from rossec.errors import ChannelError, LinkCrowded, StreamRefused
from rossec.net import withheld_log
from rossec.net.aio.tasks import TaskSet
from rossec.overlay.mux import FOR_ONE_NAME, STREAMS, YOUNG, Mux, Opened, Refused, Role
from rossec.overlay.mux_units import HEADROOM, MAX_DATA, Credit, Data, End, Reset, Target
from rossec.overlay.pump import Pump

CONNECT_SECONDS: Final = (
    10.0  # to find and reach a target; also how long a connection waits for room
)
MOST_WAITING: Final = 256  # connections that wait for room
MOST_UNSENT: Final = 8 * 1024 * 1024  # twice a link's window: the peer reads nothing, but asks
_CROWDED: Final = "it has too many streams"
_FEWER: Final = (
    f"a link carries {STREAMS} connections, {FOR_ONE_NAME} to one name and {YOUNG} new ones at a "
    "time: nodes try again, or let one subscribe from there and publish for the others"
)
_log = logging.getLogger("rossec.overlay")

Dial: TypeAlias = Callable[[Target, Pump], Awaitable[socket.socket]]
"""Connects to a target. Raises a `HintedError` or an `OSError`."""


class LinkStream(Protocol):
    """What is used of `rossec.net.aio.SecureStream`."""

    @property
    def backlog(self) -> int:
        """Bytes that were written and not sent."""

    def on_ready(
        self, callback: Callable[[], None] | None, take: Callable[[bytes], bool] | None = None
    ) -> None:
        """Call back when `next_unit` has a new result; `take` is offered a unit at once."""

    def next_unit(self) -> bytes | None:
        """The next unit. Raises a `ChannelError` after the end."""

    def write_nowait(self, data: Bytes) -> bool:
        """Send one unit; false: the link lags now."""

    async def drain(self) -> None:
        """Wait until the link does not lag."""

    def abort(self, reason: str) -> None:
        """End the link."""


async def refuse_streams(target: Target, _pump: Pump) -> socket.socket:
    """The `Dial` of the caller's side, where nothing is opened."""
    raise StreamRefused(f"a stream to {target} where none is opened")


class Streams:
    """One side of the streams of a link.

    Args:
        link: authenticated; this is its only user.
        role: whether this side made the link.
        peer: the label of the relay at the other end, for the log.
        dial: connects the called side to targets.
        clock: monotonic, in seconds.
        round_trip: of the link when it is idle, in seconds; 0 if that is not known.
    """

    def __init__(
        self,
        link: LinkStream,
        role: Role,
        peer: str,
        dial: Dial = refuse_streams,
        clock: Callable[[], float] = time.monotonic,
        *,
        round_trip: Callable[[], float] = float,
    ) -> None:
        self._link = link
        self._peer = peer
        self._dial = dial
        self._clock = clock
        self._round_trip = round_trip
        self._mux = Mux(role)
        self._pumps: dict[int, Pump] = {}
        self._buffer = memoryview(bytearray(HEADROOM + MAX_DATA))
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
        """Whether no further stream can ever be opened: the next one needs another link."""
        return self._mux.used_up or self._over.done()

    async def run(self) -> None:
        """Carry until the link ends.

        Raises:
            ChannelError: how the link ended.
            StreamRefused: the peer broke the rules, so the link was ended.
        """
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

    async def carry(self, target: Target, sock: socket.socket) -> None:
        """Open a stream to `target` for this connection; returns when it is over. Owns `sock`.

        Raises:
            LinkCrowded: there was no room; `sock` is closed.
            StreamRefused: the link has ended; `sock` is closed.
        """
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

    async def _room_for(self, target: Target) -> None:
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

    async def _connect(self, number: int, pump: Pump, target: Target) -> None:
        try:
            async with asyncio.timeout(CONNECT_SECONDS):
                sock = await self._dial(target, pump)
            pump.connect(sock)
        except (HintedError, OSError, TimeoutError) as error:
            withheld_log.warn(_log, withheld_log.REFUSED, str(target), self._peer, error)
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
        """Handle a unit at once."""
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

    def _handle(self, event: Opened | Refused | Data | Credit | End | Reset) -> None:
        match event:
            case Opened(number, target):
                self._tasks.spawn(self._connect(number, self._add(number), target), str(target))
            case Refused(_, target, reply):
                withheld_log.warn(_log, withheld_log.REFUSED, str(target), self._peer, _CROWDED)
                self._write(reply)
            case _:
                pump = self._pumps.get(event.stream)
                if pump is not None:
                    self._tell(pump, event)

    def _tell(self, pump: Pump, event: Data | Credit | End | Reset) -> None:
        match event:
            case Data(_, payload):
                pump.arrived(payload)
            case Credit():
                pump.resume()
            case End(stream):
                pump.ended(over=stream not in self._mux)
            case Reset():
                pump.break_off()

    def _add(self, number: int) -> Pump:
        self.idle_since = None
        pump = self._pumps[number] = Pump(number, self)
        return pump

    # -- from pumps

    def buffer_for(self, stream: int) -> memoryview | None:
        """As of `StreamEnd`: at most what may be sent."""
        if self._draining:
            self._waiting[stream] = None
            return None
        room = min(self._mux.credit(stream), MAX_DATA)
        return self._buffer[HEADROOM : HEADROOM + room] if room else None

    def send(self, stream: int, count: int) -> None:
        """As of `StreamEnd`; the head is written in front of the payload, which is not copied."""
        head = self._mux.data(stream, count)
        begin = HEADROOM - len(head)
        self._buffer[begin:HEADROOM] = head
        self._write(self._buffer[begin : HEADROOM + count])

    def took(self, stream: int, count: int) -> None:
        """As of `StreamEnd`."""
        self._write(self._mux.took(stream, count, self._clock(), self._round_trip()))

    def end(self, stream: int) -> bool:
        """As of `StreamEnd`."""
        self._write(self._mux.end(stream))
        return stream in self._mux

    def reset(self, stream: int) -> None:
        """As of `StreamEnd`; also after a connection was closed in order."""
        if self._pumps.pop(stream, None) is None:
            return
        self._write(self._mux.reset(stream))
        if not self._pumps:
            self.idle_since = self._clock()
        self._wake_openers()

    # -- to the link

    def _write(self, unit: Bytes) -> None:
        """Send a unit; only small ones are written while the link lags."""
        if not unit or self._over.done():
            return
        try:
            writable = self._link.write_nowait(unit)
        except ChannelError as error:
            self._fail(error)
            return
        if not writable and not self._draining:
            self._draining = True
            self._tasks.spawn(self._drain(), "a link that lags")
        elif not writable and self._link.backlog > MOST_UNSENT:
            self._fail(StreamRefused("the peer asks without reading"))

    async def _drain(self) -> None:
        """Read connections again when the link has room, each once and in their order."""
        try:
            await self._link.drain()
        except ChannelError as error:
            self._fail(error)
            return
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
