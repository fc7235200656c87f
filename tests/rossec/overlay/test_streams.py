"""Streams over a real secure stream: bytes, ends, back-pressure, and what ends a link."""

import asyncio
import contextlib
import secrets
import socket
import struct

import pytest

from rossec.errors import ChannelError, LinkCrowded, StreamRefused
from rossec.overlay import streams as module
from rossec.overlay.mux import FIRST as WINDOW
from rossec.overlay.mux import SERVICE, YOUNG, Role, StreamTarget, data_head, end_unit, open_unit
from rossec.overlay.streams import Pump, Streams
from tests.support.relays import ROBOT, Ends, carried, echo, linked, program, secure_pair, tcp_pair, to_port


async def ask(ends: Ends, data: bytes) -> bytes:
    reader, writer = ends
    writer.write(data)
    return await reader.readexactly(len(data))


async def test_streams_carry_bytes_both_ways_at_the_same_time() -> None:
    payload = secrets.token_bytes(3_000_000)
    async with program(echo) as port, linked(to_port(port)) as link:
        async with carried(link.caller) as one, carried(link.caller) as two:
            there, back = await asyncio.gather(ask(one, payload), ask(two, payload[::-1]))
        assert (there, back) == (payload, payload[::-1])


async def test_an_end_is_passed_on_and_the_other_direction_goes_on() -> None:
    async def count(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(b"%d" % len(await reader.read()))

    async with program(count) as port, linked(to_port(port)) as link:
        async with carried(link.caller) as (reader, writer):
            writer.write(bytes(700_000))
            writer.write_eof()
            assert await reader.read() == b"700000"
        assert (len(link.caller), len(link.called)) == (0, 0)
        assert link.caller.idle_since is not None


async def test_a_reset_is_passed_on_as_a_reset() -> None:
    seen: asyncio.Future[Exception] = asyncio.get_running_loop().create_future()

    async def wait(reader: asyncio.StreamReader, _: asyncio.StreamWriter) -> None:
        try:
            await reader.readexactly(2)
        except Exception as error:  # noqa: BLE001 - the test looks at it
            seen.set_result(error)

    async with program(wait) as port, linked(to_port(port)) as link, carried(link.caller) as (_, writer):
        writer.write(b"x")
        await asyncio.sleep(0.05)
        sock = writer.get_extra_info("socket")
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        writer.transport.abort()
        async with asyncio.timeout(10):
            assert isinstance(await seen, ConnectionResetError)


async def test_a_target_that_cannot_be_reached_resets_the_connection(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async def refuse(target: StreamTarget, _: Pump) -> socket.socket:
        raise ConnectionRefusedError(f"nobody is at {target}")

    async with linked(refuse) as link, carried(link.caller) as (reader, writer):
        writer.write(b"hello")
        with pytest.raises(ConnectionResetError):
            await reader.read()
        assert len(link.called) == 0
    assert "node /robot: refused home: nobody is at node /robot" in caplog.text


async def test_a_crash_of_the_called_side_ends_its_stream_alone(caplog: pytest.LogCaptureFixture) -> None:
    async with program(echo) as port:
        reach = to_port(port)

        async def dial(target: StreamTarget, pump: Pump) -> socket.socket:
            if target.kind == SERVICE:
                raise ZeroDivisionError
            return await reach(target, pump)

        async with linked(dial) as link, carried(link.caller) as one:
            async with carried(link.caller, StreamTarget(SERVICE, "/sum")) as (reader, _):
                with pytest.raises(ConnectionResetError):
                    await reader.read()
            assert await ask(one, b"still here") == b"still here"
    assert "service /sum crashed" in caplog.text


async def test_what_comes_before_the_target_is_connected_is_kept() -> None:
    go = asyncio.Event()
    async with program(echo) as port:
        reach = to_port(port)

        async def slowly(target: StreamTarget, pump: Pump) -> socket.socket:
            assert await pump.first_bytes(lambda first: first[:5] if len(first) > 4 else None)
            await go.wait()
            return await reach(target, pump)

        async with linked(slowly) as link, carried(link.caller) as (reader, writer):
            writer.write(b"he")
            await asyncio.sleep(0.01)
            writer.write(b"llo" + bytes(WINDOW))
            writer.write_eof()
            await asyncio.sleep(0.05)
            go.set()
            assert await reader.read() == b"hello" + bytes(WINDOW)


async def test_a_program_that_does_not_read_stops_its_own_stream_alone() -> None:
    async def pour(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while True:
            writer.write(bytes(1 << 16))
            await writer.drain()

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await (pour if await reader.read(1) == b"p" else echo)(reader, writer)

    async with program(serve) as port, linked(to_port(port)) as link:
        mine, theirs = await tcp_pair()  # nobody reads at `mine`
        lagging = asyncio.ensure_future(link.caller.carry(ROBOT, theirs))
        mine.send(b"p")
        async with carried(link.caller) as quick:
            writer = quick[1]
            writer.write(b"e")
            await asyncio.sleep(0.2)
            for _ in range(50):
                async with asyncio.timeout(5):
                    assert await ask(quick, b"ping") == b"ping"
            assert await ask(quick, bytes(1_000_000)) == bytes(1_000_000)
            assert len(link.caller) == 2
        mine.close()
        await lagging


async def test_a_link_that_lags_is_shared_in_turns() -> None:
    """All connections have more to send than the link takes: each gets its share."""
    got = dict.fromkeys(range(6), 0)
    enough = asyncio.Event()

    async def swallow(reader: asyncio.StreamReader, _: asyncio.StreamWriter) -> None:
        (number,) = await reader.readexactly(1)
        while data := await reader.read(1 << 16):
            got[number] += len(data)
            if sum(got.values()) > 40_000_000:
                enough.set()

    async def pour(ends: Ends, number: int) -> None:
        ends[1].write(bytes((number,)))
        while True:
            ends[1].write(bytes(1 << 16))
            await ends[1].drain()

    async with program(swallow) as port, linked(to_port(port)) as link, contextlib.AsyncExitStack() as stack:
        pouring = [
            asyncio.ensure_future(pour(await stack.enter_async_context(carried(link.caller)), n)) for n in got
        ]
        async with asyncio.timeout(30):
            await enough.wait()
        for task in pouring:
            task.cancel()
        await asyncio.gather(*pouring, return_exceptions=True)
    assert min(got.values()) > 0.5 * max(got.values())


async def test_the_end_of_the_link_resets_every_connection() -> None:
    async with program(echo) as port, linked(to_port(port)) as link:
        async with carried(link.caller) as ends:
            assert await ask(ends, b"x") == b"x"
            link.far.abort("cut")
            with pytest.raises(ConnectionResetError):
                await ends[0].read()
            assert all(isinstance(error, ChannelError) for error in await link.ended())
        assert link.caller.used_up
        mine, theirs = await tcp_pair()
        with mine, pytest.raises(StreamRefused, match="has ended"):
            await link.caller.carry(ROBOT, theirs)
        assert theirs.fileno() == -1


async def test_connections_wait_for_room_and_give_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "CONNECT_SECONDS", 0.2)
    async with program(echo) as port, linked(to_port(port)) as link, contextlib.AsyncExitStack() as stack:
        many = [await stack.enter_async_context(carried(link.caller)) for _ in range(YOUNG)]
        await ask(many[-1], b"x")  # all are open, and none has answered twice
        mine, theirs = await tcp_pair()
        with mine, pytest.raises(LinkCrowded, match=f"no room.*: {YOUNG} streams are new") as caught:
            await link.caller.carry(ROBOT, theirs)
        assert "256 connections" in caught.value.hint
        for each in many[:2]:
            assert await ask(each, b"1") == b"1"
        async with carried(link.caller) as late:
            assert await ask(many[0], b"2") == b"2"
            assert await ask(late, b"at last") == b"at last"


async def test_too_many_that_wait_are_refused_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MOST_WAITING", 0)
    async with linked(to_port(1)) as link:
        mine, theirs = await tcp_pair()
        with mine, pytest.raises(LinkCrowded, match="too many connections wait"):
            await link.caller.carry(ROBOT, theirs)


@pytest.mark.parametrize(
    "units",
    [
        b"\xff",
        open_unit(1, ROBOT),
        end_unit(7),
        open_unit(0, ROBOT) + (data_head(0, 50_000) + bytes(50_000)) * 3,
    ],
    ids=["malformed", "out of turn", "never opened", "more than a sequence may have"],
)
async def test_a_peer_that_breaks_the_rules_loses_the_link(units: bytes) -> None:
    async with program(echo) as port, secure_pair() as (near, far):
        called = Streams(far, Role.CALLED, "home", to_port(port))
        task = asyncio.ensure_future(called.run())
        near.write_nowait(units)
        with pytest.raises(StreamRefused):
            await task
        await near.wait_ended()


async def test_a_bug_ends_the_link() -> None:
    """Nothing more passes when a unit made this side crash."""
    ticks = [0.0]  # the clock breaks after the first question
    async with secure_pair() as (near, far):
        called = Streams(far, Role.CALLED, "home", to_port(1), ticks.pop)
        task = asyncio.ensure_future(called.run())
        near.write_nowait(open_unit(0, ROBOT))
        with pytest.raises(IndexError):
            await task
        await near.wait_ended()
