import asyncio

import pytest

from ca.enrollment.messages import MAX_MESSAGE, frame
from ca.errors import EnrollmentMessageRefused
from rossec.enrollment import sessions


def fed(data: bytes) -> asyncio.StreamReader:
    reader = asyncio.StreamReader(limit=MAX_MESSAGE)
    reader.feed_data(data)
    reader.feed_eof()
    return reader


async def test_messages_one_after_the_other() -> None:
    reader = fed(frame(b"one") + frame(b"x" * MAX_MESSAGE))
    assert await sessions.receive(reader) == b"one"
    assert len(await sessions.receive(reader)) == MAX_MESSAGE
    with pytest.raises(EOFError):
        await sessions.receive(reader)


async def test_a_length_beyond_the_limit() -> None:
    with pytest.raises(EnrollmentMessageRefused, match="octets where 1 to 8192 are allowed"):
        await sessions.receive(fed(b"\xff\xff\xff\xff"))


@pytest.mark.parametrize("size", range(7))
async def test_a_frame_cut_short(size: int) -> None:
    with pytest.raises(EOFError):
        await sessions.receive(fed(frame(b"abc")[:size]))


async def test_what_is_sent_is_received() -> None:
    received: asyncio.Queue[bytes] = asyncio.Queue()

    async def take(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        received.put_nowait(await sessions.receive(reader))
        writer.close()

    server = await asyncio.start_server(take, "127.0.0.1", 0)
    async with server:
        _, writer = await asyncio.open_connection(*server.sockets[0].getsockname())
        sessions.send(writer, b"a request")
        assert await received.get() == b"a request"
        writer.close()
        await writer.wait_closed()
