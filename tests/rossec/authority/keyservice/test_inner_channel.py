"""Calls in both directions over one socketpair, and the end of a side that breaks the protocol."""

import asyncio
import socket
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager

import pytest

from ca.encoding import Value
from ca.errors import EncodingError
from rossec.authority.keyservice import front_end as module
from rossec.authority.keyservice import messages
from rossec.authority.keyservice.front_end import Handler, InnerChannel
from rossec.authority.keyservice.messages import InnerAnswer, InnerRequest
from rossec.errors import ConfigurationError, KeyMessageRefused, KeyServiceRefused

LIMIT = 10_000


async def join(data: bytes) -> Value:
    if data == b"refuse":
        raise ConfigurationError("not now", "later")
    if data == b"wait":
        await asyncio.sleep(60)
    return data[::-1]


HANDLERS: Mapping[str, Handler] = {"join": join}


@asynccontextmanager
async def pair(
    handlers: Mapping[str, Handler] = HANDLERS,
) -> AsyncIterator[tuple[InnerChannel, InnerChannel]]:
    one, other = socket.socketpair()
    service = InnerChannel(one, handlers, LIMIT)
    face = InnerChannel(other, {}, LIMIT)
    running = asyncio.gather(service.run(), face.run(), return_exceptions=True)
    try:
        yield service, face
    finally:
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)


async def test_calls_are_answered_in_any_order() -> None:
    async with pair() as (_, face):
        slow = asyncio.ensure_future(face.call("join", b"wait", within=50))
        calls = (face.call("join", bytes((65 + n, 48)), within=10) for n in range(20))
        assert await asyncio.gather(*calls) == [bytes((48, 65 + n)) for n in range(20)]
        assert not slow.done()
        slow.cancel()


async def test_a_refusal_comes_back_with_its_hint() -> None:
    async with pair() as (_, face):
        with pytest.raises(KeyServiceRefused, match="not now") as caught:
            await face.call("join", b"refuse", within=10)
        assert caught.value.hint == "later"
        with pytest.raises(TimeoutError):
            await face.call("join", b"wait", within=0.05)
        assert await face.call("join", b"ab", within=10) == b"ba", "after one that was given up"


async def test_a_request_that_crashes_is_answered_and_logged(caplog: pytest.LogCaptureFixture) -> None:
    async def crash(_: bytes) -> Value:
        raise ZeroDivisionError

    async with pair({"join": crash}) as (_, face):
        with pytest.raises(KeyServiceRefused, match="could not do it"):
            await face.call("join", b"ab", within=10)
    assert "ZeroDivisionError" in caplog.text


async def test_what_cbor_cannot_hold_is_not_sent() -> None:
    async with pair() as (_, face):
        with pytest.raises(EncodingError):
            await face.call("join", 1 << 70, within=10)
        assert await face.call("join", b"ab", within=10) == b"ba"


async def test_the_end_of_one_side_ends_the_calls_of_the_other() -> None:
    one, other = socket.socketpair()
    face = InnerChannel(other, {}, LIMIT)
    running = asyncio.ensure_future(face.run())
    call = asyncio.ensure_future(face.call("join", b"ab", within=50))
    await asyncio.sleep(0.05)
    one.close()
    await running
    for attempt in (call, face.call("join", b"ab", within=50)):
        with pytest.raises(KeyServiceRefused, match="has ended"):
            await attempt


@pytest.mark.parametrize(
    "data",
    [
        b"\0\0\0\1\xff",
        b"\0\0\0\0",
        b"\xff\xff\xff\xff",
        (LIMIT + 1).to_bytes(4),
        messages.write(InnerRequest(1, "call", ("m", [], 1))),
    ],
)
async def test_a_side_that_breaks_the_protocol_is_cut_off(data: bytes) -> None:
    one, other = socket.socketpair()
    service = InnerChannel(one, HANDLERS, LIMIT)
    running = asyncio.ensure_future(service.run())
    reader, writer = await asyncio.open_connection(sock=other)
    writer.write(data)
    with pytest.raises(KeyMessageRefused):
        await running
    assert await reader.read() == b""
    writer.close()


async def test_requests_at_a_time_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_REQUESTS", 3)
    one, other = socket.socketpair()
    service = InnerChannel(one, HANDLERS, LIMIT)
    running = asyncio.ensure_future(service.run())
    _, writer = await asyncio.open_connection(sock=other)
    for number in range(4):
        writer.write(messages.write(InnerRequest(number, "join", (b"wait",))))
    with pytest.raises(KeyMessageRefused, match="may not be made now"):
        await running
    writer.close()


async def test_a_side_without_that_operation_ends() -> None:
    async with pair() as (service, face):
        assert await face.call("join", b"ab", within=10) == b"ba"
        with pytest.raises(KeyServiceRefused, match="has ended"):
            await service.call("ready", 1, within=10)


async def test_an_answer_to_nothing_is_ignored() -> None:
    one, other = socket.socketpair()
    service = InnerChannel(one, HANDLERS, LIMIT)
    running = asyncio.ensure_future(service.run())
    reader, writer = await asyncio.open_connection(sock=other)
    writer.write(messages.write(InnerAnswer(77, b"nobody asked")))
    writer.write(messages.write(InnerRequest(1, "join", (b"ab",))))
    size = int.from_bytes(await reader.readexactly(4))
    answer = messages.read(await reader.readexactly(size), LIMIT)
    assert answer == InnerAnswer(1, b"ba")
    writer.close()
    await running
