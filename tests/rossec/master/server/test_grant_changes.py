"""Waiting for deposited grants: until one for the caller's key, or a timeout; bounded per key."""

import asyncio

from rossec.master.server.updates import MAX_WAITING, GrantChanges

ONE, TWO = b"1" * 32, b"2" * 32


async def waits(changes: GrantChanges, holder: bytes) -> "asyncio.Task[None]":
    task = asyncio.ensure_future(changes.wait(holder))
    await asyncio.sleep(0)
    return task


async def test_a_grant_ends_the_waits_of_its_holder_only() -> None:
    changes = GrantChanges()
    own, other = [await waits(changes, ONE) for _ in range(2)], await waits(changes, TWO)
    assert len(changes) == 3
    changes.notify([ONE, b"3" * 32])
    async with asyncio.timeout(30):
        await asyncio.gather(*own)
    assert not other.done()
    assert len(changes) == 1
    other.cancel()
    await asyncio.wait([other])
    assert len(changes) == 0, "nothing is left of a call whose connection ended"


async def test_the_wait_ends_without_a_grant() -> None:
    changes = GrantChanges(0.01)
    async with asyncio.timeout(30):
        await changes.wait(ONE)
    assert len(changes) == 0


async def test_of_too_many_waits_of_one_key_the_oldest_ends() -> None:
    changes = GrantChanges()
    tasks = [await waits(changes, ONE) for _ in range(MAX_WAITING)]
    last = await waits(changes, ONE)
    async with asyncio.timeout(30):
        await tasks[0]
    assert not any(task.done() for task in (*tasks[1:], last))
    assert len(changes) == MAX_WAITING
    changes.notify([ONE])
    async with asyncio.timeout(30):
        await asyncio.gather(*tasks, last)
