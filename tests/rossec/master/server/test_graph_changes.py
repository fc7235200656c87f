"""Waiting for news: woken by a change, else after a while."""

import asyncio

from rossec.master.server.graph_changes import GraphChanges


async def waits(news: GraphChanges) -> "asyncio.Task[None]":
    task = asyncio.ensure_future(news.wait(60))
    await asyncio.sleep(0)
    return task


async def test_a_change_wakes_everybody_who_waits() -> None:
    news = GraphChanges()
    news.notify(1)
    tasks = [await waits(news) for _ in range(2)]
    news.notify(1)  # nothing new
    await asyncio.sleep(0)
    assert not any(task.done() for task in tasks)
    news.notify(2)
    async with asyncio.timeout(30):
        await asyncio.gather(*tasks)


async def test_what_is_no_change_of_state_may_be_news_as_well() -> None:
    news = GraphChanges()
    task = await waits(news)
    news.notify()
    async with asyncio.timeout(30):
        await task


async def test_without_news_the_wait_ends() -> None:
    async with asyncio.timeout(30):
        await GraphChanges().wait(0.01)
