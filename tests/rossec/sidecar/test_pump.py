"""What a pump does before and beside the bytes that just pass."""

import asyncio
import struct

import pytest

from rossec.errors import HeaderRefused
from rossec.ros import header
from rossec.sidecar.plain import PlainStream
from rossec.sidecar.pump import split_header
from tests.rossec.sidecar.test_plain import pair


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
