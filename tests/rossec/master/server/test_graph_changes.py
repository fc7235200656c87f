"""Waiting for changes of the graph: until a change, or a timeout."""

import asyncio

from rossec.master.server.updates import GraphChanges


async def waits(changes: GraphChanges) -> "asyncio.Task[None]":
    task = asyncio.ensure_future(changes.wait(60))
    await asyncio.sleep(0)
    return task


async def test_a_change_ends_every_wait() -> None:
    changes = GraphChanges()
    changes.notify(1)
    tasks = [await waits(changes) for _ in range(2)]
    changes.notify(1)  # nothing new
    await asyncio.sleep(0)
    assert not any(task.done() for task in tasks)
    changes.notify(2)
    async with asyncio.timeout(30):
        await asyncio.gather(*tasks)


async def test_a_notification_without_a_version_ends_the_wait() -> None:
    changes = GraphChanges()
    task = await waits(changes)
    changes.notify()
    async with asyncio.timeout(30):
        await task


async def test_the_wait_ends_without_a_change() -> None:
    async with asyncio.timeout(30):
        await GraphChanges().wait(0.01)


async def test_a_change_between_the_call_and_its_first_step_counts() -> None:
    changes = GraphChanges()
    wait = changes.wait(30.0, changes.expect())
    changes.notify(1)
    async with asyncio.timeout(15):
        await wait
