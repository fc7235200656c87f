"""A link as a transport, by itself: between two recorders, over inboxes in memory."""

import asyncio
from functools import partial
from typing import Any

import pytest

from rossec.overlay import endpoint as link_transport_module
from rossec.overlay.endpoint import LinkTransport
from rossec.overlay.link import Link
from rossec.overlay.link_frames import LinkFrameKind, kind_of
from tests.support.frame_carriers import MemoryCarrier
from tests.support.overlay import until

HERE = "rossec/1/open/" + 32 * "a"
THERE = "rossec/1/open/" + 32 * "b"
ID = bytes(range(16))


class Recorder:
    """The owner of a transport, with a small buffer."""

    transport: LinkTransport

    def __init__(self) -> None:
        self.buffer = bytearray(1000)
        self.got = bytearray()
        self.events: list[str] = []
        self.crash = False

    def get_buffer(self) -> memoryview:
        return memoryview(self.buffer)

    def buffer_updated(self, count: int) -> None:
        if self.crash:
            raise ValueError("a bug")
        self.got += self.buffer[:count]

    def eof_received(self) -> None:
        self.events.append("eof")

    def resume_writing(self) -> None:
        self.events.append("drained")

    def connection_lost(self) -> None:
        self.events.append("lost")


class Pair:
    """Both ends of a link, authenticated."""

    def __init__(self) -> None:
        self.carrier = MemoryCarrier()
        self.alice, self.bob = Recorder(), Recorder()
        link = Link.open(ID, HERE, asyncio.get_running_loop().time())
        self.a = self._end(self.alice, link, THERE, HERE)
        self.carrier.subscribe(THERE, self._accept)

    def _end(self, owner: Recorder, link: Link, key: str, own: str) -> LinkTransport:
        closed = partial(owner.events.append, "closed")
        transport = LinkTransport(link, key, self.carrier, closed, owner)
        self.carrier.subscribe(own, transport.frame_received)
        transport.resume_reading()
        return transport

    def _accept(self, frame: bytes) -> None:
        link = Link.accept(frame, asyncio.get_running_loop().time())
        self.b = self._end(self.bob, link, HERE, THERE)
        self.b.frame_received(frame)

    async def begin(self, *, validate: bool = True) -> None:
        self.a.write(b"hello")
        await until(lambda: self.bob.got)
        self.b.write(b"hello yourself")
        await until(lambda: self.alice.got)
        for each in (self.a, self.b) if validate else ():
            each.validated()
        self.alice.got.clear()
        self.bob.got.clear()


@pytest.fixture
async def pair() -> Pair:
    made = Pair()
    await made.begin()
    return made


async def test_bytes_arrive_both_ways(pair: Pair) -> None:
    data = bytes(range(256)) * 4000
    pair.a.write(data)
    pair.b.write(memoryview(data)[:5000])
    await until(lambda: len(pair.bob.got) == len(data) and len(pair.alice.got) == 5000)
    assert pair.bob.got == data
    assert pair.alice.got == data[:5000]
    assert pair.a.local_address == ""


async def test_what_was_written_may_change(pair: Pair) -> None:
    data = bytearray(8 << 20)
    pair.b.pause_reading()
    pair.a.write(data)
    pair.a.limit_unsent()  # what the window does not take waits here anyway
    assert pair.a.backlog > 0
    data[:] = b"x" * len(data)
    pair.b.resume_reading()
    await until(lambda: len(pair.bob.got) == len(data))
    assert not any(pair.bob.got)


async def test_a_reader_that_pauses_closes_the_window(pair: Pair) -> None:
    pair.b.pause_reading()
    assert not pair.b.reading
    for _ in range(20):
        pair.a.write(bytes(1 << 20))
    await asyncio.sleep(0.05)
    assert pair.bob.got == b""
    assert not pair.a.writable
    sent = sum(len(frame) for _, frame in pair.carrier.sent(LinkFrameKind.DATA))
    assert sent < 6 << 20
    pair.b.resume_reading()
    await until(lambda: len(pair.bob.got) == 20 << 20)
    await until(lambda: "drained" in pair.alice.events)
    await until(lambda: pair.a.writable and pair.a.backlog == 0)


async def test_one_side_ends_while_the_other_goes_on(pair: Pair) -> None:
    pair.a.write(b"the last")
    pair.a.write_eof()
    await until(lambda: "lost" in pair.bob.events)
    assert pair.bob.got == b"the last"
    assert pair.bob.events == ["eof", "closed", "lost"]
    await until(lambda: "lost" in pair.alice.events)
    assert pair.a.closed
    assert pair.b.closed
    assert pair.carrier.sent(LinkFrameKind.RESET) == []


async def test_an_end_is_seen_only_after_what_was_before_it(pair: Pair) -> None:
    pair.b.pause_reading()
    pair.a.write(bytes(50_000))
    pair.a.write_eof()
    await until(lambda: pair.b.link.peer_ended)
    await asyncio.sleep(0.01)
    assert pair.bob.events == []
    pair.b.resume_reading()
    await until(lambda: "eof" in pair.bob.events)
    assert len(pair.bob.got) == 50_000


async def test_an_end_that_nothing_preceded_is_seen_when_it_is_read(pair: Pair) -> None:
    pair.b.pause_reading()
    pair.a.write_eof()
    await until(lambda: pair.b.link.peer_ended)
    pair.b.resume_reading()
    await until(lambda: "eof" in pair.bob.events)


async def test_both_finish(pair: Pair) -> None:
    pair.a.write(bytes(3 << 20))
    pair.a.finish()
    pair.b.finish()
    pair.b.resume_reading()  # too late
    assert not pair.b.reading
    await until(lambda: "lost" in pair.alice.events and "lost" in pair.bob.events)
    assert "eof" not in pair.alice.events


async def test_an_abort_is_told(pair: Pair) -> None:
    pair.a.disconnect()  # a link has no socket: its end is told, and to its owner later
    pair.a.abort()  # once is enough
    assert pair.alice.events == ["closed"]  # the owner is told in the next turn
    await until(lambda: "lost" in pair.bob.events)
    assert pair.alice.events == ["closed", "lost"]
    assert pair.bob.events == ["closed", "lost"]
    assert "reset" in str(pair.b.reason)
    assert pair.b.reason is not None
    assert pair.b.reason.__traceback__ is None
    assert len(pair.carrier.sent(LinkFrameKind.RESET)) == 1
    for late in (pair.a, pair.b):
        late.write(b"late")
        late.write_eof()
        late.validated()
        late.resume_reading()
        late.frame_received(b"late")
        assert not late.reading


async def test_a_malformed_frame_ends_the_link(pair: Pair) -> None:
    pair.b.frame_received(b"\xff" * 60)
    await until(lambda: "lost" in pair.bob.events)
    assert pair.b.reason is not None


async def test_a_crash_of_the_owner_passes_nothing_more(pair: Pair) -> None:
    pair.bob.crash = True
    crashes: list[dict[str, Any]] = []
    asyncio.get_running_loop().set_exception_handler(lambda _, told: crashes.append(told))
    pair.a.write(b"x")
    await until(lambda: crashes)
    assert pair.b.closed
    await until(lambda: "lost" in pair.alice.events)


async def test_an_abort_in_the_midst_of_what_arrives(pair: Pair) -> None:
    def abort(count: int) -> None:
        pair.bob.got += pair.bob.buffer[:count]
        pair.b.abort()

    pair.bob.buffer_updated = abort  # type: ignore[method-assign]
    pair.a.write(bytes(5000))
    await until(lambda: "lost" in pair.bob.events)
    assert len(pair.bob.got) == 1000


async def test_what_is_lost_is_sent_again(pair: Pair) -> None:
    lost = 0

    def fate(_key: str, frame: bytes) -> int:
        nonlocal lost
        first = kind_of(frame) == LinkFrameKind.DATA and not lost
        lost += first
        return 0 if first else 2

    pair.carrier.fate = fate
    pair.a.write(b"once")
    await until(lambda: pair.bob.got)
    assert pair.bob.got == b"once"
    assert pair.a.link.stats.retransmissions >= 1


async def test_many_frames_of_a_turn_are_acknowledged_together(pair: Pair) -> None:
    await asyncio.sleep(0.05)
    before = len(pair.carrier.sent(LinkFrameKind.ACK))
    for _ in range(30):
        pair.a.write(bytes(2000))
    await until(lambda: len(pair.bob.got) == 60_000)
    await asyncio.sleep(0.05)
    assert len(pair.carrier.sent(LinkFrameKind.ACK)) - before <= 3


async def test_a_caller_that_is_not_validated_is_sent_three_times_as_much() -> None:
    pair = Pair()
    pair.a.write(b"hello")
    await until(lambda: pair.bob.got)
    pair.b.write(bytes(1 << 20))
    await asyncio.sleep(0.3)
    received = sum(len(frame) for key, frame in pair.carrier.frames if key == THERE)
    answered = sum(len(frame) for key, frame in pair.carrier.frames if key == HERE)
    assert answered <= 3 * received
    pair.a.abort()


async def test_a_session_in_which_nothing_arrives_is_replaced(
    pair: Pair, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(link_transport_module, "STALLED", 0.3)
    pair.carrier.fate = lambda _key, _frame: 0
    pair.a.write(b"x")
    await until(lambda: pair.carrier.reopened)
    assert not pair.a.closed
    pair.carrier.fate = lambda _key, _frame: 1
    await until(lambda: pair.bob.got)
    assert pair.bob.got == b"x"


async def test_a_session_in_which_others_are_heard_is_kept(
    pair: Pair, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(link_transport_module, "STALLED", 0.3)
    pair.carrier.fate = lambda _key, _frame: 0
    pair.a.write(b"x")
    for _ in range(10):
        await asyncio.sleep(0.1)
        pair.carrier.heard_at = asyncio.get_running_loop().time()
    assert pair.carrier.reopened == 0


async def test_a_link_without_progress_is_given_up(pair: Pair, monkeypatch: pytest.MonkeyPatch) -> None:
    pair.carrier.fate = lambda _key, _frame: 0
    pair.a.write(b"x")
    loop = asyncio.get_running_loop()
    now = loop.time()
    monkeypatch.setattr(loop, "time", lambda: now + 40)
    pair.a._on_timer()
    monkeypatch.undo()
    assert "no progress" in str(pair.a.reason)
    assert pair.carrier.reopened == 0
    await until(lambda: "lost" in pair.alice.events)


async def test_a_crash_of_the_link_passes_nothing_more(pair: Pair, monkeypatch: pytest.MonkeyPatch) -> None:
    def crash(*_: object) -> None:
        raise ValueError("a bug")

    with monkeypatch.context() as patch:
        patch.setattr(Link, "receive", crash)
        with pytest.raises(ValueError, match="a bug"):
            pair.b.frame_received(b"")
    assert pair.b.closed
    await until(lambda: "lost" in pair.alice.events)
