"""Forwards a program's messages to a subscribing peer that has wishes.

A shell. The guard comes first, as without wishes: if it keeps state, or only the newest message is
wished, messages are checked as they come, and a peer that lags misses some; else it slows the
program down. What the program sent before it closed is delivered.
"""

import asyncio
from collections import deque
from time import monotonic
from typing import Final

from ca.certificates import Identity
from ca.domains.aliases import shown
from rossec import clock
from rossec.errors import ChannelClosed
from rossec.net.aio import SecureStream
from rossec.net.aio.arrivals import next_messages
from rossec.participant.deflating import LARGE, deflated
from rossec.participant.wished_rate import WishedRate
from rossec.participant.wishes import Wishes
from rossec.ros.framing import Framing
from rossec.ros.header import FrameReader
from rossec.sidecar.core.copies import MessageGuard, SharedGuard
from rossec.sidecar.plain_stream import PlainStream
from rossec.sidecar.pump import Buffer, expect_no_data, filtered, framed, run_both

_LAGGING: Final = 64 * 1024  # bytes that wait, above which a peer lags


class WishSender:
    """Sends filtered messages to `peer` as it wishes.

    Attributes:
        newest: whether a message replaces those that wait.
    """

    def __init__(self, peer: SecureStream[Identity], wishes: Wishes) -> None:
        self.newest = wishes.newest
        self._peer = peer
        self._deflate = wishes.deflate
        self._rate = None if wishes.rate is None else WishedRate(wishes.rate)
        self._held = 0  # bytes that wait
        self._waiting: deque[list[Buffer]] = deque(maxlen=1 if wishes.newest else None)
        self._wake, self._idle = asyncio.Event(), asyncio.Event()
        self._idle.set()
        if wishes.newest:
            peer.transport.limit_unsent()

    @property
    def lags(self) -> bool:
        """Whether further messages would have to wait."""
        return self._held > _LAGGING or self._peer.lags

    def put(self, pieces: list[Buffer]) -> None:
        """Send a filtered message, if the rate admits it; empty: it was withheld."""
        if not pieces or (self._rate is not None and not self._rate.admits(monotonic())):
            return
        self._held = _size(pieces) + (0 if self.newest else self._held)
        self._waiting.append(pieces)
        self._idle.clear()
        self._wake.set()

    async def idle(self) -> None:
        """Wait until nothing waits."""
        await self._idle.wait()

    async def run(self) -> None:
        """Send what is put, until the connection ends, which raises."""
        while True:
            await self._wake.wait()
            self._wake.clear()
            while self._waiting:
                if self.newest:
                    await self._peer.flushed()
                await self._send(self._waiting.popleft())
            self._idle.set()

    async def _send(self, pieces: list[Buffer]) -> None:
        size = _size(pieces)
        self._held -= size
        if self._deflate:
            large = size >= LARGE
            pieces = [await asyncio.to_thread(deflated, pieces) if large else deflated(pieces)]
        await self._peer.send(*framed(pieces))


def _size(pieces: list[Buffer]) -> int:
    return sum(map(len, pieces))


async def publish(
    program: PlainStream,
    peer: SecureStream[Identity],
    guard: MessageGuard | None,
    initial: bytes,
    sender: WishSender,
) -> None:
    """As `pump.publish`, by way of `sender`."""
    forwarding = forward(program, shown(peer.peer.name), guard, initial, sender)
    await run_both(program, peer, forwarding, sender.run(), expect_no_data(peer))


async def forward(
    program: PlainStream,
    peer: str,
    guard: MessageGuard | None,
    initial: bytes,
    sender: WishSender,
) -> None:
    """Put a program's messages to `sender`, each as the guard returns it.

    Raises:
        GrantExpired, ChannelClosed: the grant has expired, or the program has closed.
        FrameRefused: the framing is invalid.
        LimitExceeded: a message does not arrive in time.
    """
    framing = Framing(FrameReader())
    messages = framing.feed(initial, clock.now())
    keeps_state = isinstance(guard, SharedGuard)
    while True:
        now = clock.time()
        if guard is not None:
            guard.check(now)
        if sender.newest or not keeps_state or not sender.lags:
            for message in messages:
                sender.put([message] if guard is None else filtered(guard, message, peer, now))
        if not sender.newest and not keeps_state:
            await sender.idle()
        try:
            messages = await next_messages(program, framing)
        except ChannelClosed:
            await sender.idle()
            raise
