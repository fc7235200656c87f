"""The web process's side of the scanner."""

import asyncio
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest

from rossec.console import scanning
from rossec.console.scanning import Found, Unreadable
from rossec.console.server.web import ScannerClient
from rossec.errors import RossecError, ScannerBusy


class Supervised:
    """A client, and the other end of its socketpair."""

    def __init__(self, interval: float = 0.0) -> None:
        theirs, self.end = socket.socketpair()
        self.client = ScannerClient(theirs, interval)

    def answers(self, *answers: Found | Unreadable) -> None:
        self.end.sendall(b"".join(map(scanning.write_answer, answers)))


@asynccontextmanager
async def supervised(interval: float = 0.0) -> AsyncIterator[Supervised]:
    pair = Supervised(interval)
    with pair.end:
        yield pair
        await pair.client.close()


async def test_the_text_of_a_code_is_returned() -> None:
    async with supervised() as pair:
        pair.answers(Found("ROSSEC:A"), Found(""))
        assert await pair.client.read(b"one") == "ROSSEC:A"
        assert await pair.client.read(b"two") is None
        assert pair.end.recv(100) == scanning.frame(b"one") + scanning.frame(b"two")


async def test_a_picture_that_could_not_be_read_is_refused_with_its_reason() -> None:
    async with supervised() as pair:
        pair.answers(Unreadable("several codes", "show one"))
        with pytest.raises(RossecError, match="several codes") as refusal:
            await pair.client.read(b"one")
        assert refusal.value.hint == "show one"


@pytest.mark.parametrize("size", [0, scanning.MAX_PICTURE + 1])
async def test_a_picture_of_no_or_too_great_size_is_not_sent(size: int) -> None:
    async with supervised() as pair:
        with pytest.raises(RossecError, match="at most 256 kB"):
            await pair.client.read(bytes(size))
        await pair.client.close()
        assert pair.end.recv(1) == b""


async def test_one_picture_at_a_time() -> None:
    async with supervised() as pair:
        first = asyncio.ensure_future(pair.client.read(b"one"))
        await asyncio.sleep(0)
        with pytest.raises(ScannerBusy):
            await pair.client.read(b"two")
        pair.answers(Found(""))
        assert await first is None


async def test_pictures_are_some_time_apart() -> None:
    async with supervised(3600) as pair:
        pair.answers(Found(""), Found(""))
        assert await pair.client.read(b"one") is None
        second = asyncio.ensure_future(pair.client.read(b"two"))
        await asyncio.sleep(0.05)
        assert not second.done()
        with pytest.raises(ScannerBusy):
            await pair.client.read(b"three")
        second.cancel()


@pytest.mark.parametrize("data", [b"", b"\0\0\0\0", scanning.frame(b"no CBOR")])
async def test_without_a_supervisor_pictures_are_refused(data: bytes) -> None:
    async with supervised() as pair:
        pair.end.sendall(data)
        pair.end.close()
        for _ in range(2):
            with pytest.raises(RossecError, match="cannot be read any more"):
                await pair.client.read(b"x")


async def test_an_answer_that_nobody_awaits_is_not_given_to_the_next_picture() -> None:
    async with supervised() as pair:
        first = asyncio.ensure_future(pair.client.read(b"one"))
        await asyncio.sleep(0.01)
        first.cancel()
        await asyncio.gather(first, return_exceptions=True)
        with pytest.raises(ScannerBusy):
            await pair.client.read(b"two")
        pair.answers(Found("ROSSEC:ONE"))
        await asyncio.sleep(0.05)
        pair.answers(Found("ROSSEC:THREE"))
        assert await pair.client.read(b"three") == "ROSSEC:THREE"
