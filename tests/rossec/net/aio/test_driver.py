"""A peer that begins a unit is asked whether it gets on, as long as it is read."""

import asyncio
import itertools

import pytest

from rossec.channel.negotiation import GrantsPresented, IdentityRenewed
from rossec.errors import LimitExceeded
from rossec.net.aio import connect, serve
from rossec.net.aio import stream as driver_module
from rossec.net.aio.server import SecureServer
from rossec.net.aio.stream import SecureStream
from rossec.peer_limits import MIN_BYTES, STEP, WINDOW
from tests.support.contexts import context
from tests.support.secure_streams import Stream, call, echo
from tests.support.wire import ALICE, BOB, FakeIdentity, renewed, renews

WHOLE = bytes(4 * MIN_BYTES)


async def begin(stream: Stream, server: SecureServer[FakeIdentity]) -> SecureStream[FakeIdentity]:
    """Send the first record of a unit; the driver at the other end, which has it."""
    await stream.send(b"x")
    assert await stream.receive() == b"x"
    (driver,) = server._streams
    for record in itertools.islice(stream.connection.seal_unit(WHOLE), 1):
        stream.write(record)
    async with asyncio.timeout(30):
        while not driver.connection.has_unfinished_unit:  # noqa: ASYNC110 - no event to wait for
            await asyncio.sleep(0.001)
    return driver


async def test_a_peer_that_stalls_in_a_unit_is_disconnected(monkeypatch: pytest.MonkeyPatch) -> None:
    async with serve(echo, "127.0.0.1", 0, context(BOB)) as server:
        stream = await call(server)
        driver = await begin(stream, server)
        assert driver._timer is not None
        assert driver._timer.when() <= driver._loop.time() + STEP
        clock = itertools.count(driver_module.wall_clock(), STEP)
        monkeypatch.setattr(driver_module, "wall_clock", lambda: next(clock))
        for _ in range(2 * WINDOW // STEP):
            if driver.error is None:
                driver._run_timers()
        assert isinstance(driver.error, LimitExceeded)
        stream.abort("done")


async def test_a_peer_that_is_not_read_does_not_time_out(monkeypatch: pytest.MonkeyPatch) -> None:
    async with serve(echo, "127.0.0.1", 0, context(BOB)) as server:
        stream = await call(server)
        driver = await begin(stream, server)
        driver.transport.pause_reading()
        clock = itertools.count(driver_module.wall_clock(), STEP)
        monkeypatch.setattr(driver_module, "wall_clock", lambda: next(clock))
        for _ in range(10 * WINDOW // STEP):
            driver._run_timers()
        assert driver.error is None
        stream.abort("done")


async def test_what_the_peer_renews_is_told_in_order() -> None:
    """Grants that come before anybody listens wait; a certificate is that of the peer at once."""
    own = context(ALICE, renews=renews)
    async with serve(echo, "127.0.0.1", 0, context(BOB, renews=renews)) as server:
        stream = await connect("127.0.0.1", server.port, own)
        await stream.send(b"x")
        await stream.receive()
        (driver,) = server._streams
        first = driver.peer
        own.open_streams.present(renewed(ALICE))
        assert stream.present_grants(b"grants")
        await stream.send(b"y")
        assert await stream.receive() == b"y"
        assert driver.peer.certificate == renewed(ALICE)[0] != first.certificate
        heard: list[object] = []
        driver.on_renewal(heard.append)
        assert heard == [GrantsPresented(b"grants")]
        own.open_streams.present(renewed(ALICE, 2))
        await stream.send(b"z")
        assert await stream.receive() == b"z"
        assert [type(event) for event in heard[1:]] == [IdentityRenewed]
        assert stream.connection.takes_renewals
        stream.abort("done")
        assert not stream.present_grants(b"grants")
        own.open_streams.present(renewed(ALICE, 3))
