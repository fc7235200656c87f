"""Secure streams on links: dialled to an inbox and accepted there, with strangers about."""

import asyncio
import logging
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import pytest

from rossec.channel.records import ChannelLimits
from rossec.errors import ChannelClosed, ConnectionTruncated, HandshakeTimeout, IdentityRefused, PeerRefused
from rossec.net.aio import serve
from rossec.net.limits import HalfOpenCount, HalfOpenLimits
from rossec.overlay import endpoint as endpoint_module
from rossec.overlay.endpoint import OPENS_PER_SECOND, LinkListener, dial_link, idle_round_trip, stats_of
from rossec.overlay.link_frames import (
    HEAD,
    OPEN_SIZE,
    LinkFrameKind,
    head,
    is_inbox,
    kind_of,
    return_address,
    split_return_address,
)
from tests.support.contexts import context
from tests.support.frame_carriers import MemoryCarrier
from tests.support.overlay import carrier, router, until
from tests.support.secure_streams import Stream, call, echo
from tests.support.wire import ALICE, BOB, STRANGER, FakeIdentity

KEY = "rossec/1/open/" + 32 * "b"
VICTIM = "rossec/1/open/" + 32 * "f"
IMPATIENT = ChannelLimits(handshake_seconds=1)
Listener = LinkListener[FakeIdentity]


def opening(number: int, body: bytes = b"\x0c") -> bytes:
    """An OPEN as a stranger makes it, with answers to the victim."""
    address = return_address(VICTIM, OPEN_SIZE - HEAD - len(body))
    return head(LinkFrameKind.OPEN, number.to_bytes(16), 0, 0, 1 << 16) + address + body


@asynccontextmanager
async def listening(**options: Any) -> AsyncIterator[tuple[MemoryCarrier, Listener]]:
    """Bob's inbox, which echoes."""
    memory = MemoryCarrier()
    async with LinkListener(memory, KEY, context(BOB, **options), echo) as listener:
        yield memory, listener


async def dial(memory: MemoryCarrier, **options: Any) -> Stream:
    return await dial_link(memory, KEY, "ward", context(ALICE, **options))


async def test_both_are_authenticated_and_bytes_pass() -> None:
    async with listening() as (memory, listener):
        async with await dial(memory) as stream:
            assert stream.peer.name == "/bob"
            assert stream.local_address == ""
            data = bytes(range(256)) * 20_000
            await stream.send(data)
            assert await stream.receive() == data
            assert listener.connections == 1
            stats = stats_of(stream)
            assert stats.sent > len(data) < stats.received
            assert 0 < stats.least_s <= stats.srtt_s
            assert idle_round_trip(stream) == stats_of(stream).least_s
        with pytest.raises(ChannelClosed):
            await stream.receive()
        await until(lambda: listener.connections == 0 and memory.readers.keys() == {KEY})
        assert listener._links == {}


async def test_answers_arrive_in_an_inbox_of_the_own_account() -> None:
    async with listening() as (memory, _), await dial(memory):
        (answers,) = memory.readers.keys() - {KEY}
        assert is_inbox(answers)
        assert answers.startswith("rossec/1/ward/")


async def test_frames_of_other_links_in_the_inbox_for_answers_are_nothing() -> None:
    async with listening() as (memory, _), await dial(memory) as stream:
        (answers,) = memory.readers.keys() - {KEY}
        memory.put(answers, head(LinkFrameKind.RESET, bytes(16), 0, 0, 0))
        memory.put(answers, b"")
        await stream.send(b"still")
        assert await stream.receive() == b"still"


async def test_a_stranger_is_refused() -> None:
    async with listening() as (memory, listener):
        stream = await dial_link(memory, KEY, "ward", context(STRANGER))
        with pytest.raises(PeerRefused):
            await stream.receive()
        await until(lambda: not listener._links)


async def test_a_stranger_who_answers_is_refused() -> None:
    memory = MemoryCarrier()
    async with LinkListener(memory, KEY, context(STRANGER), echo):
        with pytest.raises(IdentityRefused):
            await dial(memory)
        await until(lambda: memory.readers.keys() == {KEY})


async def test_nobody_answers() -> None:
    memory = MemoryCarrier()
    with pytest.raises(HandshakeTimeout):
        await dial(memory, limits=IMPATIENT)
    await until(lambda: not memory.readers)


async def test_a_dial_that_is_given_up_leaves_nothing() -> None:
    memory = MemoryCarrier()
    with pytest.raises(TimeoutError):
        async with asyncio.timeout(0.05):
            await dial(memory)
    assert memory.readers == {}


async def test_a_dial_that_cannot_begin_leaves_nothing() -> None:
    memory = MemoryCarrier()
    with pytest.raises(IndexError):
        await dial(memory, suites=())
    assert memory.readers == {}


async def test_a_crashing_handler_ends_only_its_link(caplog: pytest.LogCaptureFixture) -> None:
    async def picky(stream: Stream) -> None:
        await stream.send(bytes([100 // (await stream.receive())[0]]))
        await echo(stream)

    memory = MemoryCarrier()
    async with LinkListener(memory, KEY, context(BOB), picky):
        bad, good = await dial(memory), await dial(memory)
        await bad.send(b"\x00")
        with pytest.raises(ConnectionTruncated):
            await bad.receive()
        await good.send(b"\x0a")
        assert await good.receive() == b"\x0a"
        await good.close()
    assert "ZeroDivisionError" in caplog.text


async def test_closing_the_listener_ends_its_links_at_once() -> None:
    memory = MemoryCarrier()
    listener = LinkListener(memory, KEY, context(BOB), echo)
    stream = await dial(memory)
    await stream.send(b"x")
    assert await stream.receive() == b"x"
    await listener.close()
    assert KEY not in memory.readers
    with pytest.raises(ConnectionTruncated):
        await stream.receive()


async def test_so_many_frames_of_strangers_are_looked_at_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    async with listening() as (memory, listener):
        now = asyncio.get_running_loop().time()
        monkeypatch.setattr(endpoint_module, "_now", lambda: now)
        for number in range(3 * OPENS_PER_SECOND):
            listener._receive(opening(number))
        assert listener.connections == OPENS_PER_SECOND
        monkeypatch.setattr(endpoint_module, "_now", lambda: now + 0.5)
        for number in range(1000, 1000 + OPENS_PER_SECOND):
            listener._receive(opening(number))
        assert len(listener._links) <= OPENS_PER_SECOND + OPENS_PER_SECOND // 2
        monkeypatch.undo()
        async with await dial(memory) as stream:  # half a second is paid for by now
            await stream.send(b"x")
            assert await stream.receive() == b"x"


async def test_unfinished_handshakes_of_an_inbox_are_limited(caplog: pytest.LogCaptureFixture) -> None:
    caps = HalfOpenCount(HalfOpenLimits(per_address=3))
    async with listening(half_open=caps) as (memory, listener):
        good = await dial(memory)
        await good.send(b"x")
        assert await good.receive() == b"x"
        for number in range(10):
            memory.put(KEY, opening(number))
        await until(lambda: "too many unfinished handshakes" in caplog.text)
        assert listener.connections == 4
        assert KEY not in caplog.text
        await good.send(b"x")
        assert await good.receive() == b"x"
        await good.close()


async def test_a_forged_answer_address_does_not_amplify() -> None:
    async with listening(limits=IMPATIENT) as (memory, listener):
        first = await dial(memory)
        await first.close()
        ((_, real),) = memory.sent(LinkFrameKind.OPEN)
        _, message_1 = split_return_address(memoryview(real)[HEAD:])
        memory.frames.clear()
        frame = opening(7, bytes(message_1))
        for _ in range(3):  # again: it counts, but for no new link
            memory.put(KEY, frame)
        await until(lambda: listener.connections)
        await until(lambda: not listener.connections)
        answered = [data for key, data in memory.frames if key == VICTIM]
        assert answered  # message_2 fits
        assert sum(map(len, answered)) <= 3 * 3 * len(frame)


async def test_what_is_no_link_has_no_effect(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    async with listening() as (memory, listener):
        for kind in (LinkFrameKind.DATA, LinkFrameKind.ACK, LinkFrameKind.RESET, LinkFrameKind.END):
            memory.put(KEY, head(kind, bytes(16), 0, 0, 0) + b"x")
        memory.put(KEY, b"\x01")
        memory.put(KEY, b"")
        broken = bytearray(opening(1))
        broken[HEAD + 5] ^= 1
        memory.put(KEY, bytes(broken))
        await until(lambda: "refused: a frame that does not say where to answer" in caplog.text)
        assert listener.connections == 0
        assert [key for key, _ in memory.frames if key != KEY] == []


async def test_who_asks_for_a_link_that_is_unknown_is_told() -> None:
    async with listening() as (memory, _):
        probe = head(LinkFrameKind.PROBE, bytes(16), 0, 0, 0) + return_address(VICTIM, OPEN_SIZE - HEAD)
        memory.put(KEY, probe)
        await until(lambda: memory.sent(LinkFrameKind.RESET))
        ((key, answer),) = memory.sent(LinkFrameKind.RESET)
        assert key == VICTIM
        assert len(answer) < len(probe)
        memory.put(KEY, head(LinkFrameKind.PROBE, bytes(16), 0, 0, 0))  # says nothing of where to answer
        await asyncio.sleep(0.01)
        assert len(memory.sent(LinkFrameKind.RESET)) == 1


async def test_frames_that_are_lost_twice_or_late_change_nothing() -> None:
    count = 0

    def fate(_key: str, frame: bytes) -> int:
        nonlocal count
        count += 1
        return 0 if count % 5 == 0 else 1 + (kind_of(frame) == LinkFrameKind.DATA)

    async with listening() as (memory, _):
        memory.fate = fate
        stream = await dial(memory)
        for size in (1, 1000, 300_000):
            await stream.send(bytes(size))
            assert await stream.receive() == bytes(size)
        await stream.close()


async def test_only_a_stream_over_a_link_has_its_figures() -> None:
    async with serve(echo, "127.0.0.1", 0, context(BOB)) as server, await call(server) as stream:
        with pytest.raises(TypeError, match="not over a link"):
            stats_of(stream)
        assert idle_round_trip(stream) == 0


async def test_a_slow_receiver_leaves_other_links_at_their_pace() -> None:
    async def slow_or_echo(stream: Stream) -> None:
        if await stream.receive() == b"slow":
            await asyncio.sleep(60)
        await echo(stream)

    async def flood(stream: Stream) -> None:
        while True:
            await stream.send(bytes(100_000))

    with router() as locator:
        async with (
            carrier(locator) as mine,
            carrier(locator) as theirs,
            LinkListener(theirs, KEY, context(BOB), slow_or_echo),
        ):
            slow, quick = [await dial_link(mine, KEY, "open", context(ALICE)) for _ in range(2)]
            await slow.send(b"slow")
            flooding = asyncio.get_running_loop().create_task(flood(slow))
            await until(lambda: slow.lags)
            sent = stats_of(slow).sent
            await quick.send(b"first")
            for _ in range(50):
                await quick.send(b"x")
                assert await quick.receive() == b"x"
            assert stats_of(quick).retransmissions == 0
            assert stats_of(slow).sent - sent < 8 << 20
            flooding.cancel()
            for each in (slow, quick):
                each.abort("done")
