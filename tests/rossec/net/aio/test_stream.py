"""Streams over loopback: units, bursts, back-pressure, forwarding, closes."""

import asyncio
import contextlib
import gc
import socket
import weakref

import pytest

from rossec.channel.opening import WireProtocol
from rossec.channel.records import Bytes, ChannelLimits
from rossec.errors import ChannelClosed, ConnectionTruncated, LimitExceeded
from rossec.net.aio import SecureServer, connect, serve
from rossec.net.aio import stream as driver_module
from rossec.net.aio import stream as secure_module
from rossec.net.aio.transport import Transport
from tests.support.contexts import context
from tests.support.secure_streams import Stream, call, echo, still_works
from tests.support.wire import ALICE, BOB, FakeIdentity


@pytest.mark.parametrize("protocol", list(WireProtocol))
@pytest.mark.parametrize("size", [1, 70_000, 3_000_000])
async def test_units_there_and_back(protocol: WireProtocol, size: int) -> None:
    async with (
        serve(echo, "127.0.0.1", 0, context(BOB), protocol) as server,
        await call(server, protocol) as stream,
    ):
        assert stream.peer.name == "/bob"
        assert stream.address == "127.0.0.1"
        await stream.send(b"x" * size, b"tail")
        assert await stream.receive() == b"x" * size + b"tail"
    with pytest.raises(ChannelClosed):
        await stream.receive()
    with pytest.raises(ChannelClosed):
        await stream.send(b"late")


async def test_nothing_waits_for_nagle(server: SecureServer[FakeIdentity]) -> None:
    async with await call(server) as stream:
        for each in (stream, *server._streams):
            assert isinstance(each.transport, Transport)
            sock = each.transport._socket
            assert sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)


async def test_a_connection_that_ended_holds_nothing() -> None:
    ended: list[weakref.ref[object]] = []

    async def serving(stream: Stream) -> None:
        ended.append(weakref.ref(stream))
        await echo(stream)

    async with serve(serving, "127.0.0.1", 0, context(BOB)) as server:
        gc.collect()
        gc.disable()  # or it might do the work
        try:
            stream = await call(server)
            ended.append(weakref.ref(stream))
            await stream.send(b"x")
            await stream.receive()
            await stream.close()
            with pytest.raises(ChannelClosed):
                await stream.receive()
            del stream
            while any(each() is not None for each in ended):  # noqa: ASYNC110 - no event to wait for
                await asyncio.sleep(0.001)
        finally:
            gc.enable()
    assert len(ended) == 2


async def test_a_burst_is_joined_after_its_first_unit(
    server: SecureServer[FakeIdentity], monkeypatch: pytest.MonkeyPatch
) -> None:
    now = 1000.0
    monkeypatch.setattr(secure_module, "monotonic", lambda: now)
    async with await call(server) as stream:
        for pieces in ((b"alone",), (b"and ",), (b"the ",), (), (b"oth", b"ers")):
            await stream.send(*pieces)
        assert await stream.receive() == b"alone"
        assert await stream.receive() == b"and the others"
        now += 1
        await stream.send(b"later")
        assert await stream.receive() == b"later"


async def test_a_single_unit_is_offered_before_it_is_queued(server: SecureServer[FakeIdentity]) -> None:
    async with await call(server) as stream:
        called, offered = asyncio.Event(), list[bytes]()

        def take(unit: bytes) -> bool:
            offered.append(unit)
            called.set()
            return unit != b"kept"

        stream.on_ready(called.set, take)
        for unit in (b"taken", b"kept", b"behind"):
            await stream.send(unit)
            await asyncio.wait_for(called.wait(), 10)
            called.clear()
        assert offered == [b"taken", b"kept"]
        assert (stream.next_unit(), stream.next_unit()) == (b"kept", b"behind")
        assert stream.next_unit() is None


async def test_after_an_error_where_a_unit_is_taken_nothing_passes(
    server: SecureServer[FakeIdentity],
) -> None:
    """Also one of another connection's: it is not this one that has ended."""
    stream = await call(server)
    asyncio.get_running_loop().set_exception_handler(lambda *_: None)
    offered = list[bytes]()

    def take(unit: bytes) -> bool:
        offered.append(unit)
        raise ChannelClosed("another connection has ended")

    stream.on_ready(lambda: None, take)
    await stream.send(b"one")
    await asyncio.wait_for(stream.wait_ended(), 10)
    assert (offered, stream.transport.closed) == ([b"one"], True)


async def test_a_slow_reader_stops_the_writer() -> None:
    go = asyncio.Event()
    got = 0

    async def slow(stream: Stream) -> None:
        nonlocal got
        await go.wait()
        while True:
            got += len(await stream.receive())

    async with serve(slow, "127.0.0.1", 0, context(BOB)) as server:
        stream = await call(server)
        lags = [stream.lags]
        sent = 0
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(1):
                while True:
                    await asyncio.shield(asyncio.ensure_future(stream.send(b"x" * 500_000)))
                    sent += 500_000
        assert sent < 64_000_000
        assert [*lags, stream.lags] == [False, True]
        go.set()
        await stream.send(b"z")
        await stream.close()
        await asyncio.sleep(0.1)
        assert got == sent + 500_000 + 1


async def test_a_send_given_up_half_way_ends_the_connection() -> None:
    async def deaf(stream: Stream) -> None:
        await asyncio.sleep(60)

    async with serve(deaf, "127.0.0.1", 0, context(BOB)) as server:
        stream = await call(server)
        await stream.send(b"x" * 3_000_000)  # more than the peer takes unread: it stops reading
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.5):
                await stream.send(b"x" * 100_000_000)
        with pytest.raises(ChannelClosed, match="half-way"):
            await stream.send(b"y")


async def test_an_abort_is_a_truncation_for_the_peer(server: SecureServer[FakeIdentity]) -> None:
    stream = await call(server)
    stream.abort("revoked")
    with pytest.raises(ChannelClosed, match="revoked"):
        await stream.receive()
    with contextlib.suppress(ZeroDivisionError):
        async with await call(server) as other:
            raise ZeroDivisionError
    with pytest.raises(ChannelClosed, match="failed"):
        await other.receive()
    await still_works(server)


async def test_nothing_passes_a_disconnected_stream_and_nobody_is_told_yet(
    server: SecureServer[FakeIdentity],
) -> None:
    stream = await call(server)
    await stream.send(b"x")
    assert await stream.receive() == b"x"  # both sides have ended the handshake
    (served,) = server._streams
    told: list[str] = []
    served.when_closed(lambda: told.append("closed"))
    served.disconnect()
    served.abort("revoked")
    assert told == [], "in this turn"
    with pytest.raises(ConnectionTruncated):
        await stream.receive()
    with pytest.raises(ChannelClosed, match="revoked"):
        await served.receive()
    await still_works(server)
    assert told == ["closed"]
    served.disconnect()  # of a socket that is closed: nothing


async def test_the_socket_is_closed_before_the_end_is_told(server: SecureServer[FakeIdentity]) -> None:
    stream = await call(server)
    told: list[bool] = []
    stream._on_end = lambda ended, _: told.append(ended.transport.closed)
    stream.abort("revoked")
    assert told == [True]


async def test_when_closed_is_called_at_the_end_of_the_socket() -> None:
    async with serve(echo, "127.0.0.1", 0, context(BOB)) as server:
        stream = await call(server)
        called: list[str] = []
        stream.when_closed(lambda: called.append("then"))
        await stream.close()
        stream.when_closed(lambda: called.append("later"))
        assert called == ["then", "later"]


async def test_a_peer_that_does_not_answer_the_close_is_aborted(
    server: SecureServer[FakeIdentity], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(driver_module, "LINGER", 0.1)
    stream = await call(server)
    await stream.send(b"x")
    await stream.receive()
    (there,) = server._streams
    there.transport.pause_reading()
    closing = asyncio.get_running_loop().create_task(stream.close())
    await asyncio.sleep(0)
    stream._on_timer()  # a timer that was set for something earlier
    assert not stream.transport.closed
    async with asyncio.timeout(30):
        await closing
    assert stream.transport.closed


async def test_a_small_unit_waits_behind_a_large_one() -> None:
    async def count(stream: Stream) -> None:
        await asyncio.sleep(0.1)
        got = 0
        while got < 20_000_005:
            got += len(await stream.receive())
        await stream.send(b"all")

    async with serve(count, "127.0.0.1", 0, context(BOB)) as server:
        stream = await call(server)
        large = asyncio.ensure_future(stream.send(bytes(20_000_000)))
        await asyncio.sleep(0.01)
        await stream.send(b"small")
        assert large.done()
        assert await stream.receive() == b"all"
        stream.abort("done")


async def test_a_unit_limit_below_what_is_joined(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(secure_module, "monotonic", lambda: 0.0)  # all of it is one burst
    limits = ChannelLimits(unit=10)
    async with serve(echo, "127.0.0.1", 0, context(BOB, limits=limits)) as server:
        stream = await connect("127.0.0.1", server.port, context(ALICE, limits=limits))
        for _ in range(5):
            await stream.send(b"1234567")
            await stream.send(memoryview(b"89"), b"")
        with pytest.raises(LimitExceeded):
            await stream.send(b"x" * 11)
        got = b""
        while len(got) < 45:
            got += await stream.receive()
        assert got == b"123456789" * 5
        await stream.close()


async def test_a_peer_that_does_not_follow_a_renewal_ends_the_queue() -> None:
    limits = ChannelLimits(records=1)
    async with serve(echo, "127.0.0.1", 0, context(BOB)) as server:
        stream = await connect("127.0.0.1", server.port, context(ALICE, limits=limits))
        stream.transport.pause_reading()
        with pytest.raises(LimitExceeded, match="renewal"):  # noqa: PT012 - some sends
            for _ in range(9):
                await stream.send(b"x")
                await asyncio.sleep(0)
        with pytest.raises(LimitExceeded):
            await stream.receive()


async def test_addresses_are_those_of_the_connection(server: SecureServer[FakeIdentity]) -> None:
    stream = await call(server)
    assert stream.local_address == "127.0.0.1"
    stream.abort("done")
    assert stream.local_address == ""


async def test_a_burst_waits_for_a_peer_that_lags(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(secure_module, "monotonic", lambda: 0.0)
    go, sent = asyncio.Event(), 0

    async def late(stream: Stream) -> None:
        await go.wait()
        got = 0
        while got < sent:
            got += len(await stream.receive())
        await stream.send(b"all")

    async with serve(late, "127.0.0.1", 0, context(BOB)) as server:
        stream = await call(server)
        while not stream.lags:
            await stream.send(b"x" * 1000)
            sent += 1000
        await asyncio.sleep(0)  # the end of the burst cannot be flushed yet
        go.set()
        assert await stream.receive() == b"all"
        stream.abort("done")


async def forwarded_from(server: SecureServer[FakeIdentity], sink: list[Bytes]) -> None:
    """Everything that comes back, with a receiver that lags after each."""
    async with await call(server) as stream:
        await stream.drain()
        for number in range(20):
            assert stream.write_nowait(bytes([number]) * 1000)

        def write_nowait(unit: Bytes) -> bool:
            sink.append(unit)
            return False

        async def drain() -> None:
            await asyncio.sleep(0)
            if sum(map(len, sink)) == 20_000:
                await stream.close()

        await stream.forward(write_nowait, drain)


async def test_forwarded_units_arrive_in_order(server: SecureServer[FakeIdentity]) -> None:
    sink: list[Bytes] = []
    with pytest.raises(ChannelClosed):
        await forwarded_from(server, sink)
    assert b"".join(sink) == b"".join(bytes([number]) * 1000 for number in range(20))


async def test_a_receiver_that_fails_ends_the_forwarding(server: SecureServer[FakeIdentity]) -> None:
    async with await call(server) as stream:

        def write_nowait(_: Bytes) -> bool:
            raise ArithmeticError

        forwarding = asyncio.ensure_future(stream.forward(write_nowait, stream.drain))
        await asyncio.sleep(0)
        stream.write_nowait(b"x")
        with pytest.raises(ArithmeticError):
            await forwarding
    with pytest.raises(ChannelClosed):
        stream.write_nowait(b"late")
