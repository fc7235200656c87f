"""Accepted connections: half open within limits, then each with its handler."""

import asyncio
import contextlib
import errno
import logging

import pytest

from rossec.channel.records import ChannelLimits
from rossec.errors import ChannelError, HandshakeFailed
from rossec.net.aio import serve
from rossec.net.aio import server as accepted_module
from rossec.net.limits import HalfOpenCount, HalfOpenLimits
from tests.support.contexts import context
from tests.support.secure_streams import Stream, call, echo, raw, still_works
from tests.support.wire import BOB
from tests.support.witness import until


async def test_a_crashing_handler_ends_only_its_connection(caplog: pytest.LogCaptureFixture) -> None:
    async def picky(stream: Stream) -> None:
        unit = await stream.receive()
        await stream.send(bytes([100 // unit[0]]))
        await echo(stream)

    async with serve(picky, "127.0.0.1", 0, context(BOB)) as server:
        bad, good = await call(server), await call(server)
        await bad.send(b"\x00")
        with pytest.raises(ChannelError):
            await bad.receive()
        await good.send(b"\x0a")
        assert await good.receive() == b"\x0a"
        await good.close()
    assert "crashed" in caplog.text
    assert "ZeroDivisionError" in caplog.text


async def test_a_closed_server_leaves_no_socket_that_waits_for_its_peer() -> None:
    """A peer that reads no more answers no close: the handler is over, its connection lingers."""
    handled: list[Stream] = []

    async def brief(stream: Stream) -> None:
        handled.append(stream)

    async with serve(brief, "127.0.0.1", 0, context(BOB)) as server:
        silent = await call(server)
        silent.transport.pause_reading()
        await until(lambda: bool(handled and handled[0].error))
        assert [stream.transport.closed for stream in handled] == [False]
    assert [stream.transport.closed for stream in handled] == [True]
    silent.abort("done")


async def test_the_handshake_deadline(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    limits = ChannelLimits(handshake_seconds=1)
    async with serve(echo, "127.0.0.1", 0, context(BOB, limits=limits)) as server:
        stream = await call(server)
        assert await raw(server, b"\x0c\0\0") == b""
        assert "did not finish the handshake in time" in caplog.text
        await stream.send(b"x")
        assert await stream.receive() == b"x"
        await stream.close()


@pytest.mark.parametrize("caps", [HalfOpenLimits(per_address=3), HalfOpenLimits(total=3)])
async def test_half_open_caps_spare_the_others(caps: HalfOpenLimits) -> None:
    async with serve(echo, "127.0.0.1", 0, context(BOB, half_open=HalfOpenCount(caps))) as server:
        stream = await call(server)
        idle = [await asyncio.open_connection("127.0.0.1", server.port) for _ in range(3)]
        with contextlib.suppress(OSError):
            assert await raw(server, b"") == b""
        with pytest.raises(HandshakeFailed):
            await call(server)
        await stream.send(b"x")
        assert await stream.receive() == b"x"
        for _, writer in idle:
            writer.close()
        await asyncio.sleep(0.05)
        await still_works(server)
        await stream.close()


async def test_the_ports_of_a_context_share_its_limit() -> None:
    own = context(BOB, half_open=HalfOpenCount(HalfOpenLimits(total=1)))
    async with serve(echo, "127.0.0.1", 0, own) as one, serve(echo, "127.0.0.1", 0, own) as other:
        _, idle = await asyncio.open_connection("127.0.0.1", one.port)
        with pytest.raises(HandshakeFailed):
            await call(other)
        idle.close()
        await asyncio.sleep(0.05)
        await still_works(other)


async def test_a_caller_that_closes_at_once_releases_its_slot(monkeypatch: pytest.MonkeyPatch) -> None:
    only = HalfOpenLimits(total=1)
    async with serve(echo, "127.0.0.1", 0, context(BOB, half_open=HalfOpenCount(only))) as server:
        gone: list[str] = []

        def broken(*_: object) -> None:
            gone.append("reset")
            raise OSError(errno.EINVAL, "reset")

        with monkeypatch.context() as patch:
            patch.setattr(accepted_module, "SecureStream", broken)
            with contextlib.suppress(OSError):
                assert await raw(server, b"") == b""
        assert gone
        await still_works(server)
