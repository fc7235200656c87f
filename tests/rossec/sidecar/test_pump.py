"""What a pump does before and beside the bytes that just pass."""

import asyncio
import struct
from types import SimpleNamespace
from typing import Any

import pytest

from grants.decision import Decision
from grants.errors import GrantExpired, RestrictionMismatch
from grants.guard import Guard
from grants.memory import Memory
from grants.model import Restriction, Right
from rossec.errors import ChannelClosed, HeaderRefused
from rossec.ros import header
from rossec.sidecar.core.copies import CopyTracker
from rossec.sidecar.plain_stream import PlainStream
from rossec.sidecar.pump import outgoing, send_filtered, split_header
from tests.rossec.sidecar.test_plain_stream import pair
from tests.support.witness import until


async def test_a_header_comes_in_any_pieces_and_with_what_follows() -> None:
    near, far = pair()
    data = header.encode({"topic": b"/word"})
    sending = asyncio.ensure_future(in_pieces(near, data[:2], data[2:9], data[9:] + b"more"))
    assert await split_header(far) == ({"topic": b"/word"}, b"more")
    await sending
    for end in (near, far):
        end.abort()


async def in_pieces(end: PlainStream, *pieces: bytes) -> None:
    for piece in pieces:
        await end.send(piece)
        await asyncio.sleep(0.01)


async def test_a_header_is_bounded_before_it_is_kept() -> None:
    near, far = pair()
    await near.send(struct.pack("<I", header.HEADER_LIMIT + 1))
    with pytest.raises(HeaderRefused, match="a connection header of"):
        await split_header(far)
    for end in (near, far):
        end.abort()


class FakeGuard:
    """A guard that refuses what begins with an x, until it has expired."""

    def __init__(self, expired: bool = False) -> None:
        self.expired = expired

    def check(self, now: int) -> None:
        if self.expired:
            raise GrantExpired("the grant has expired")

    def apply(self, message: bytes, now: int) -> list[bytes] | None:
        if message.startswith(b"x"):
            raise RestrictionMismatch("it cannot be judged")
        return None if message.startswith(b"-") else [message[:1], message[1:]]


class Peer:
    """Whoever subscribes, and what it was sent."""

    def __init__(self) -> None:
        self.peer = SimpleNamespace(name="/viewer")
        self.heard = b""

    async def send(self, *pieces: bytes) -> None:
        self.heard += b"".join(pieces)


async def received_by_peer(guard: FakeGuard, *messages: bytes) -> bytes:
    """What a peer hears of the messages of a program that then ends."""
    near, far = pair()
    peer = Peer()
    await near.send(b"".join(map(header.frame, messages[1:])))
    closing = asyncio.ensure_future(near.close())
    sending: Any = send_filtered
    try:
        await sending(far, peer, guard, header.frame(messages[0]))
    except ChannelClosed:
        return peer.heard
    finally:
        far.abort()
        await closing
        assert not guard.expired or peer.heard == b""
    raise AssertionError


async def test_what_cannot_be_judged_is_withheld(caplog: pytest.LogCaptureFixture) -> None:
    heard = await received_by_peer(FakeGuard(), b"one", *[b"x-rated"] * 9, b"-silent", b"two")
    assert heard == header.frame(b"one") + header.frame(b"two")
    assert caplog.text.count("/viewer: withheld a message: it cannot be judged") == 1


async def test_nothing_passes_after_the_end_of_the_grant() -> None:
    with pytest.raises(GrantExpired):
        await received_by_peer(FakeGuard(expired=True), b"one")


class LaggingPeer:
    """A peer that takes one message, and then no more until it is told to."""

    def __init__(self) -> None:
        self.peer = SimpleNamespace(name="/viewer")
        self.heard: list[bytes] = []
        self.lags = False

    def write_nowait(self, data: bytes) -> bool:
        self.heard.append(data)
        self.lags = True
        return False


async def test_who_lags_misses_what_is_remembered() -> None:
    """It costs no token either: what was missed was not judged."""
    many = Restriction(rate=2.0)
    decision = Decision(Right.SUBSCRIBE, "/a", (), 1 << 40, (many,))
    near, far = pair()
    peer: Any = LaggingPeer()
    guard = Guard(None, decision, None, lambda _: Memory())
    with CopyTracker().share(guard, 0, latching=False) as (shared, _):
        passing = asyncio.ensure_future(outgoing(far, peer, shared, header.frame(b"one")))
        await until(lambda: bool(peer.heard))
        await near.send(header.frame(b"missed") * 20)
        for _ in range(100):  # turns of the loop
            await asyncio.sleep(0)
        peer.lags = False
        await near.send(header.frame(b"two"))
        closing = asyncio.ensure_future(near.close())
        with pytest.raises(ChannelClosed):
            await passing
        far.abort()
        await closing
    assert peer.heard == [header.frame(b"one"), header.frame(b"two")]
