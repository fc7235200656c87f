"""Forwarding between a program and a peer: headers, guards, lagging peers."""

import asyncio
import contextlib
import logging
import struct
from collections.abc import AsyncIterator
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import pytest

from grants.decision import Decision
from grants.errors import GrantError, GrantExpired
from grants.guard import Guard, Memory
from grants.model import Restriction, Right
from rossec.errors import ChannelClosed, HeaderRefused, RossecError
from rossec.net.aio import connect, serve
from rossec.ros import tcpros
from rossec.sidecar.core.guards import CopyTracker, SharedGuard
from rossec.sidecar.loopback_port import PlainStream
from rossec.sidecar.pump import (
    exchange,
    log_end,
    publish,
    send_filtered,
    send_filtered_nowait,
    split_header,
    subscribe,
)
from tests.rossec.sidecar.test_plain_stream import pair
from tests.support.contexts import context
from tests.support.secure_streams import Stream
from tests.support.wire import ALICE, BOB
from tests.support.witness import until


async def test_a_header_is_split_from_the_bytes_that_follow() -> None:
    left, right = pair()
    data = tcpros.encode({"topic": b"/word"})
    sending = asyncio.ensure_future(in_pieces(left, data[:2], data[2:9], data[9:] + b"more"))
    assert await split_header(right) == ({"topic": b"/word"}, b"more")
    await sending
    for end in (left, right):
        end.abort()


async def in_pieces(end: PlainStream, *pieces: bytes) -> None:
    for piece in pieces:
        await end.send(piece)
        await asyncio.sleep(0.01)


async def test_a_header_length_is_checked_before_buffering() -> None:
    left, right = pair()
    await left.send(struct.pack("<I", tcpros.HEADER_LIMIT + 1))
    with pytest.raises(HeaderRefused, match="a connection header of"):
        await split_header(right)
    for end in (left, right):
        end.abort()


class FakeGuard:
    """A guard that refuses messages that begin with x; optionally expired."""

    def __init__(self, expired: bool = False) -> None:
        self.expired = expired

    def check(self, now: int) -> None:
        if self.expired:
            raise GrantExpired("the grant has expired")

    def apply(self, message: bytes, now: int) -> list[bytes] | None:
        if message.startswith(b"x"):
            raise GrantError("it cannot be checked")
        return None if message.startswith(b"-") else [message[:1], message[1:]]


class Peer:
    """A subscribing peer that records what it receives."""

    def __init__(self) -> None:
        self.peer = SimpleNamespace(name="/viewer")
        self.received = b""

    async def send(self, *pieces: bytes) -> None:
        self.received += b"".join(pieces)


async def received_by_peer(guard: FakeGuard, *messages: bytes) -> bytes:
    """What a peer receives of the messages of a program that then closes."""
    left, right = pair()
    peer = Peer()
    await left.send(b"".join(map(tcpros.frame, messages[1:])))
    closing = asyncio.ensure_future(left.close())
    sending: Any = send_filtered
    try:
        await sending(right, peer, guard, tcpros.frame(messages[0]))
    except ChannelClosed:
        return peer.received
    finally:
        right.abort()
        await closing
        assert not guard.expired or peer.received == b""
    raise AssertionError


async def test_messages_that_cannot_be_checked_are_withheld(caplog: pytest.LogCaptureFixture) -> None:
    received = await received_by_peer(FakeGuard(), b"one", *[b"x-rated"] * 9, b"-silent", b"two")
    assert received == tcpros.frame(b"one") + tcpros.frame(b"two")
    assert caplog.text.count("/viewer: withheld a message: it cannot be checked") == 1


async def test_no_message_passes_after_the_grant_expires() -> None:
    with pytest.raises(GrantExpired):
        await received_by_peer(FakeGuard(expired=True), b"one")


class LaggingPeer:
    """A peer that lags after each message."""

    def __init__(self) -> None:
        self.peer = SimpleNamespace(name="/viewer")
        self.received: list[bytes] = []
        self.lags = False

    def write_nowait(self, data: bytes) -> bool:
        self.received.append(data)
        self.lags = True
        return False


async def test_a_lagging_peer_misses_messages() -> None:
    """A missed message costs no token: it was not checked."""
    many = Restriction(rate=2.0)
    decision = Decision(Right.SUBSCRIBE, "/a", (), 1 << 40, (many,))
    left, right = pair()
    peer: Any = LaggingPeer()
    guard = Guard(None, decision, None, lambda _: Memory())
    with CopyTracker().share(guard, 0, latching=False) as (shared, _):
        assert isinstance(shared, SharedGuard)
        forwarding = asyncio.ensure_future(send_filtered_nowait(right, peer, shared, tcpros.frame(b"one")))
        await until(lambda: bool(peer.received))
        await left.send(tcpros.frame(b"missed") * 20)
        for _ in range(100):  # iterations of the loop
            await asyncio.sleep(0)
        peer.lags = False
        await left.send(tcpros.frame(b"two"))
        closing = asyncio.ensure_future(left.close())
        with pytest.raises(ChannelClosed):
            await forwarding
        right.abort()
        await closing
    assert peer.received == [tcpros.frame(b"one"), tcpros.frame(b"two")]


async def test_an_error_ends_only_the_block(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)

    async def expire() -> None:
        raise GrantExpired("the grant has expired")

    with log_end("/viewer"):
        async with asyncio.TaskGroup() as group:
            group.create_task(expire())
    assert caplog.messages == ["the connection with /viewer ended: the grant has expired"]
    with pytest.raises(ExceptionGroup), log_end("/viewer"):
        raise ExceptionGroup("mistakes are not hidden", [ArithmeticError()])


@dataclass(frozen=True)
class Ends:
    """A program, a peer, and the sidecar's ends of their connections."""

    program: PlainStream
    inner: PlainStream
    peer: Stream
    outer: Any  # a secure stream with the identity of a fake node

    async def hear(self, end: PlainStream | Stream, wanted: int) -> bytes:
        data = b""
        async with asyncio.timeout(30):
            while len(data) < wanted:
                data += await end.receive()
        return data

    async def ended(self, *ends: PlainStream | Stream) -> None:
        for end in ends:
            with pytest.raises(RossecError):
                async with asyncio.timeout(30):
                    await end.receive()


@pytest.fixture
async def ends() -> AsyncIterator[Ends]:
    accepted: asyncio.Queue[Stream] = asyncio.Queue()
    over = asyncio.Event()

    async def handle(stream: Stream) -> None:
        accepted.put_nowait(stream)
        await over.wait()

    program, inner = pair()
    async with serve(handle, "127.0.0.1", 0, context(BOB)) as server:
        outer = await connect("127.0.0.1", server.port, context(ALICE))
        peer = await accepted.get()
        yield Ends(program, inner, peer, outer)
        over.set()
        for end in (program, inner):
            end.abort()
        for stream in (peer, outer):
            stream.abort("over")


async def test_a_service_exchanges_bytes_after_those_behind_the_headers(ends: Ends) -> None:
    running = asyncio.ensure_future(exchange(ends.inner, ends.outer, b"first ", b"early "))
    await ends.program.send(b"request")
    await ends.peer.send(b"answer")
    assert await ends.hear(ends.peer, 13) == b"first request"
    assert await ends.hear(ends.program, 12) == b"early answer"
    await ends.program.close()
    await ends.ended(ends.peer)
    await running


async def test_what_was_sent_is_delivered_before_the_other_end_is_closed(ends: Ends) -> None:
    running = asyncio.ensure_future(subscribe(ends.inner, ends.outer, None, b"a"))
    await ends.peer.send(bytes(1_000_000))
    closing = asyncio.ensure_future(ends.peer.close())
    assert await ends.hear(ends.program, 1_000_001) == b"a" + bytes(1_000_000)
    await ends.ended(ends.program)
    await asyncio.gather(running, closing)


async def test_a_publisher_without_restrictions_is_forwarded_unchanged(ends: Ends) -> None:
    running = asyncio.ensure_future(publish(ends.inner, ends.outer, None, b"no frame "))
    await ends.program.send(b"at all")
    assert await ends.hear(ends.peer, 15) == b"no frame at all"
    await ends.program.close()
    await running


async def test_a_guard_filters_what_a_program_receives(ends: Ends) -> None:
    guard: Any = FakeGuard()
    one, withheld, two = map(tcpros.frame, (b"one", b"x-rated", b"two"))
    running = asyncio.ensure_future(subscribe(ends.inner, ends.outer, guard, one[:3]))
    await ends.peer.send(one[3:] + withheld + two)
    assert await ends.hear(ends.program, 14) == one + two
    await ends.peer.close()
    await running


async def test_a_guard_filters_what_a_program_publishes(ends: Ends) -> None:
    guard: Any = FakeGuard()
    running = asyncio.ensure_future(publish(ends.inner, ends.outer, guard, b""))
    await ends.program.send(tcpros.frame(b"x-rated") + tcpros.frame(b"two"))
    assert await ends.hear(ends.peer, 7) == tcpros.frame(b"two")
    await ends.program.close()
    await running


@contextlib.contextmanager
def refused(what: str, caplog: pytest.LogCaptureFixture) -> Any:
    caplog.set_level(logging.INFO)
    with log_end("/viewer"):
        yield
    assert what in caplog.text


async def test_a_message_above_the_limit_ends_both_connections(
    ends: Ends, caplog: pytest.LogCaptureFixture
) -> None:
    guard: Any = FakeGuard()
    await ends.peer.send(tcpros.frame(bytes(11)))
    with refused("the connection with /viewer ended: ", caplog):
        await subscribe(ends.inner, ends.outer, guard, b"", 10)
    await ends.ended(ends.program, ends.peer)


@pytest.mark.parametrize("subscriber", ["peer", "program"])
async def test_a_subscriber_that_sends_data_is_disconnected(
    ends: Ends, subscriber: str, caplog: pytest.LogCaptureFixture
) -> None:
    await getattr(ends, subscriber).send(b"data")
    with refused("a subscriber that sends data", caplog):
        if subscriber == "peer":
            await publish(ends.inner, ends.outer, None, b"")
        else:
            await subscribe(ends.inner, ends.outer, None, b"")
    await ends.ended(ends.program, ends.peer)


@pytest.mark.parametrize("subscriber", ["peer", "program"])
async def test_the_end_of_a_port_while_a_subscriber_is_waited_for_is_no_crash(
    ends: Ends, subscriber: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its task is cancelled: a group of cancellations would be logged as a crash, with frames."""
    waits = asyncio.Event()

    async def close(_: object) -> None:
        waits.set()
        await asyncio.Event().wait()

    monkeypatch.setattr(PlainStream, "close", close)
    run = publish if subscriber == "peer" else subscribe
    running = asyncio.ensure_future(run(ends.inner, ends.outer, None, b"data"))
    if subscriber == "program":
        ends.program.transport.write_eof()
    else:
        ends.peer.connection.close()
        ends.peer.flush()
    await waits.wait()
    running.cancel()
    with pytest.raises(asyncio.CancelledError):
        await running
    assert running.cancelled()
