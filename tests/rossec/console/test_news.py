"""News for open pages: one question for all, numbers only, an end with the session."""

import asyncio
from collections.abc import AsyncIterator

import pytest

from rossec.authority.console.messages import Status
from rossec.console.context import ALIVE, MAX_STREAMS, SILENT, NewsFeed
from rossec.errors import HttpRefused, KeyServiceFailed

PERIOD = 0.01


class Service:
    """Counts how often it is asked."""

    def __init__(self) -> None:
        self.number, self.asked, self.fails = 1, 0, False

    async def status(self) -> Status:
        self.asked += 1
        if self.fails:
            raise KeyServiceFailed("it does not run")
        return Status("home", "ab", False, 1, self.number, 1, 1, True)


async def next_data(stream: AsyncIterator[bytes]) -> bytes:
    """The next event that is not a sign of life."""
    async with asyncio.timeout(5):
        while True:
            found = await anext(stream)
            if found.startswith(b"data: "):
                return found
            assert found in {b":\n\n", ALIVE, SILENT}


async def test_a_stream_tells_the_number_and_each_change_of_it() -> None:
    service = Service()
    news = NewsFeed(service.status, PERIOD)
    stream = news.open(lambda: True)
    assert await next_data(stream) == b"data: 1.0\n\n"
    service.number = 2
    assert await next_data(stream) == b"data: 2.0\n\n"
    news.changed()
    assert await next_data(stream) == b"data: 2.1\n\n"
    assert news.number == "2.1"
    await news.close()


async def test_a_page_is_made_at_the_number_of_that_moment() -> None:
    service = Service()
    news = NewsFeed(service.status, 60)
    stream = news.open(lambda: True)
    await next_data(stream)
    service.number = 7
    assert (await news.ask(), news.number) == ("7.0", "1.0")
    service.fails = True
    assert await news.ask() == ""
    await news.close()


async def test_fifty_streams_ask_as_often_as_one() -> None:
    service = Service()
    news = NewsFeed(service.status, 60)
    streams = [news.open(lambda: True) for _ in range(50)]
    for stream in streams:
        assert await next_data(stream) == b"data: 1.0\n\n"
    assert (service.asked, news.streams) == (1, 50)
    await news.close()


async def test_a_stream_ends_with_its_session_and_the_questions_with_the_last() -> None:
    service, valid = Service(), [True]
    news = NewsFeed(service.status, PERIOD)
    stream = news.open(lambda: valid[0], beat=PERIOD)
    await next_data(stream)
    valid[0] = False
    async with asyncio.timeout(5):
        assert {found async for found in stream} <= {b":\n\n", ALIVE}
    assert news.streams == 0
    await asyncio.sleep(20 * PERIOD)
    assert news.number is None
    before = service.asked
    await asyncio.sleep(10 * PERIOD)
    assert service.asked == before


async def test_a_service_that_is_away_is_asked_again() -> None:
    service = Service()
    service.fails = True
    news = NewsFeed(service.status, PERIOD)
    stream = news.open(lambda: True, beat=PERIOD)
    assert [await anext(stream) for _ in range(5)] == [b":\n\n", *[SILENT] * 4]
    service.fails = False
    assert await next_data(stream) == b"data: 1.0\n\n"
    assert await anext(stream) == ALIVE
    await news.close()


async def test_a_service_that_stops_answering_is_told_to_pages(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also one that hangs: then no question comes back, and none fails."""
    monkeypatch.setattr("rossec.console.context.BEAT", 3 * PERIOD)
    service = Service()
    news = NewsFeed(service.status, PERIOD)
    stream = news.open(lambda: True, beat=PERIOD)
    await next_data(stream)
    assert await anext(stream) == ALIVE
    hung = asyncio.Event()

    async def hang() -> Status:
        await hung.wait()
        return Status("home", "ab", False, 1, 1, 1, 1, True)

    news._status = hang
    async with asyncio.timeout(5):
        while await anext(stream) != SILENT:
            pass
    hung.set()
    async with asyncio.timeout(5):
        while await anext(stream) != ALIVE:
            pass
    await news.close()


async def test_streams_are_bounded() -> None:
    news = NewsFeed(Service().status, 60)
    streams = [news.open(lambda: True) for _ in range(MAX_STREAMS)]
    for stream in streams:
        await anext(stream)
    with pytest.raises(HttpRefused, match="too many pages"):
        news.open(lambda: True)
    await news.close()
