import asyncio

import pytest

from ca.enrollment.messages import MAX_MESSAGE, frame
from ca.errors import EnrollmentMessageRefused
from rossec.enrollment import wire


def fed(data: bytes) -> asyncio.StreamReader:
    reader = asyncio.StreamReader(limit=MAX_MESSAGE)
    reader.feed_data(data)
    reader.feed_eof()
    return reader


async def test_messages_one_after_the_other() -> None:
    reader = fed(frame(b"one") + frame(b"x" * MAX_MESSAGE))
    assert await wire.receive(reader) == b"one"
    assert len(await wire.receive(reader)) == MAX_MESSAGE
    with pytest.raises(EOFError):
        await wire.receive(reader)


async def test_a_length_beyond_the_limit() -> None:
    with pytest.raises(EnrollmentMessageRefused, match="octets where 1 to 8192 are allowed"):
        await wire.receive(fed(b"\xff\xff\xff\xff"))


@pytest.mark.parametrize("size", range(7))
async def test_a_frame_cut_short(size: int) -> None:
    with pytest.raises(EOFError):
        await wire.receive(fed(frame(b"abc")[:size]))
