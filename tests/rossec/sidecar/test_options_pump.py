"""A program's messages for a peer with options: after the guard, thinned out, newest, deflated."""

import asyncio
import contextlib
import logging
from collections.abc import AsyncIterator
from types import SimpleNamespace
from typing import Any

import pytest

from grants.decision import Decision
from grants.errors import GrantExpired
from grants.guard import Guard, Memory
from grants.model import Restriction, Right
from rossec.errors import ChannelClosed, WireError
from rossec.participant.delivery_options import LARGE, DeliveryOptions, DeliveryQueue, inflated
from rossec.ros import tcpros
from rossec.sidecar import pump
from rossec.sidecar.core.guards import CopyTracker, MessageGuard
from rossec.sidecar.loopback_port import PlainStream
from rossec.sidecar.pump import forward_by_options, log_end, publish_by_options
from tests.rossec.sidecar.test_plain_stream import pair
from tests.rossec.sidecar.test_pump import FakeGuard
from tests.support.witness import until


class Peer:
    """Records what it is sent, message by message; `line` lets it leave."""

    def __init__(self) -> None:
        self.peer = SimpleNamespace(name="/viewer")
        self.received: list[bytes] = []
        self.line, self.gone = asyncio.Event(), asyncio.Event()
        self.line.set()
        self.lags = False
        self.limited = self.closed = 0
        self.transport = SimpleNamespace(limit_unsent=self._limit)

    def _limit(self) -> None:
        self.limited += 1

    async def send(self, *pieces: bytes) -> None:
        await self.line.wait()
        self.received.append(b"".join(pieces[1:]))
        assert pieces[0] == len(self.received[-1]).to_bytes(4, "little")

    async def flushed(self) -> None:
        await self.line.wait()

    async def receive(self) -> bytes:
        await self.gone.wait()
        raise ChannelClosed("the peer closed the connection")

    async def close(self) -> None:
        self.closed += 1

    def abort(self, _reason: str) -> None:
        self.line.set()


async def everything(
    peer: Any, options: DeliveryOptions, *messages: bytes, guard: MessageGuard | None = None
) -> None:
    """Forward what a program sends that then closes."""
    left, right = pair()

    async def speak() -> None:
        await left.send(b"".join(map(tcpros.frame, messages[1:])))
        await left.close()

    closing = asyncio.ensure_future(speak())
    sender = DeliveryQueue(peer, options)
    try:
        await publish_by_options(right, peer, guard, tcpros.frame(messages[0]), sender)
    finally:
        right.abort()
        with contextlib.suppress(ChannelClosed):
            await closing
        left.abort()


async def test_the_rate_counts_what_the_guard_lets_pass() -> None:
    peer = Peer()
    guard: Any = FakeGuard()
    messages = b"x-rated", b"-silent", b"one", b"-silent", b"two", b"three"
    await everything(peer, DeliveryOptions(0.001), *messages, guard=guard)
    assert (peer.received, peer.closed, peer.limited) == ([b"one", b"two"], 1, 0)


@pytest.mark.parametrize("size", [0, 70, LARGE - 1, LARGE, 5 * LARGE])
async def test_messages_are_deflated(size: int) -> None:
    peer = Peer()
    await everything(peer, DeliveryOptions(deflate=True), bytes(size), b"two")
    assert [inflated(content, 1 << 20) for content in peer.received] == [bytes(size), b"two"]


async def test_a_program_waits_for_a_slow_peer_and_nothing_is_missed() -> None:
    peer = Peer()
    peer.line.clear()
    messages = [bytes([number]) * 500_000 for number in range(20)]
    running = asyncio.ensure_future(everything(peer, DeliveryOptions(deflate=True), *messages))
    for _ in range(1000):
        await asyncio.sleep(0)
    assert peer.received == []
    peer.line.set()
    await running
    assert [inflated(content, 1 << 20) for content in peer.received] == messages


async def test_of_what_waits_only_the_newest_is_sent() -> None:
    """The program is not slowed down, and its last message is delivered after it has closed."""
    peer = Peer()
    peer.line.clear()
    messages = [b"%d" % number + bytes(300_000) for number in range(50)]
    left, right = pair()
    stream: Any = peer
    sender = DeliveryQueue(stream, DeliveryOptions(newest=True))
    running = asyncio.ensure_future(publish_by_options(right, stream, None, b"", sender))
    for message in messages:
        await left.send(tcpros.frame(message))
    closing = asyncio.ensure_future(left.close())
    await until(lambda: sender._queue and sender._queue[0].pieces == [messages[-1]])
    assert peer.received == []
    peer.line.set()
    await asyncio.gather(running, closing)
    left.abort()
    assert (peer.received, peer.limited) == ([messages[-1]], 1)


def limited(rate: float) -> Guard:
    decision = Decision(Right.SUBSCRIBE, "/a", (), 1 << 40, (Restriction(rate=rate),))
    return Guard(None, decision, None, lambda _: Memory())


@contextlib.asynccontextmanager
async def forwarding(
    peer: Any, options: DeliveryOptions, guard: MessageGuard | None
) -> AsyncIterator[tuple[PlainStream, DeliveryQueue]]:
    left, right = pair()
    sender = DeliveryQueue(peer, options)
    work = asyncio.gather(sender.run(), forward_by_options(right, "/viewer", guard, b"", sender))
    try:
        yield left, sender
    finally:
        work.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await work
        left.abort()
        right.abort()


async def test_a_peer_that_lags_misses_what_a_guard_with_state_would_check() -> None:
    """And costs no token: what is missed was not checked."""
    peer: Any = Peer()
    with CopyTracker().share(limited(2.0), 0, latching=False) as (shared, _):
        async with forwarding(peer, DeliveryOptions(deflate=True), shared) as (left, sender):
            await left.send(tcpros.frame(b"one"))
            await until(lambda: peer.received)
            peer.lags = True
            assert sender.lags
            await left.send(tcpros.frame(b"missed") * 20)
            for _ in range(100):
                await asyncio.sleep(0)
            peer.lags = False
            await left.send(tcpros.frame(b"two"))
            await until(lambda: len(peer.received) == 2)
    assert [inflated(content, 99) for content in peer.received] == [b"one", b"two"]


async def test_the_newest_only_is_no_way_around_a_rate_of_the_grant() -> None:
    """Messages that are replaced were admitted, and count."""
    peer: Any = Peer()
    peer.line.clear()
    with CopyTracker().share(limited(2.0), 0, latching=False) as (shared, _):
        async with forwarding(peer, DeliveryOptions(newest=True), shared) as (left, sender):
            for number in range(40):
                await left.send(tcpros.frame(b"%d" % number))
            await until(lambda: sender._queue)
            for _ in range(100):
                await asyncio.sleep(0)
            assert [each.pieces for each in sender._queue] == [[b"1"]]
            peer.line.set()
            await until(lambda: peer.received)
    assert peer.received == [b"1"]


async def test_what_is_withheld_is_not_sent() -> None:
    peer: Any = Peer()
    sender = DeliveryQueue(peer, DeliveryOptions(newest=True))
    await sender.idle()
    assert not sender.lags
    sender.enqueue([b""])
    assert not sender._idle.is_set()


async def test_the_end_of_a_grant_ends_it(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    peer = Peer()
    guard: Any = FakeGuard(expired=True)
    with log_end("/viewer"):
        await everything(peer, DeliveryOptions(newest=True), b"one", guard=guard)
    assert f"the connection with /viewer ended: {GrantExpired('the grant has expired')}" in (caplog.messages)
    assert peer.received == []


async def test_a_message_above_the_limit_ends_both_connections(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(pump, "FrameReader", lambda: tcpros.FrameReader(10))
    caplog.set_level(logging.INFO)
    with log_end("/viewer"):
        await everything(Peer(), DeliveryOptions(deflate=True), bytes(11))
    assert str(WireError("a frame of 11 bytes, at most 10 allowed")) in caplog.text
