"""Waiting for news: woken by a change, else after a while."""

import asyncio

from rossec.master.server.graph_changes import GraphChanges


async def waits(news: GraphChanges) -> "asyncio.Task[None]":
    task = asyncio.ensure_future(news.wait(60))
    await asyncio.sleep(0)
    return task


async def test_a_change_ends_every_wait() -> None:
    news = GraphChanges()
    news.notify(1)
    tasks = [await waits(news) for _ in range(2)]
    news.notify(1)  # nothing new
    await asyncio.sleep(0)
    assert not any(task.done() for task in tasks)
    news.notify(2)
    async with asyncio.timeout(30):
        await asyncio.gather(*tasks)


async def test_a_notification_without_a_version_ends_the_wait() -> None:
    news = GraphChanges()
    task = await waits(news)
    news.notify()
    async with asyncio.timeout(30):
        await task


async def test_the_wait_ends_without_a_change() -> None:
    async with asyncio.timeout(30):
        await GraphChanges().wait(0.01)
