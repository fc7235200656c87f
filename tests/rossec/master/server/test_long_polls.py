"""The long polls: calls wait for a change, of all or for their key; few of one key, and not for ever."""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable

import pytest

from rossec.host.runner import TaskSet
from rossec.master.server.updates import LongPolls
from tests.rossec.master.world import until

LONG = 30.0
ONE, TWO = b"1" * 32, b"2" * 32

Wait = Callable[..., Awaitable[list[asyncio.Task[None]]]]


@pytest.fixture
async def waiting() -> AsyncIterator[Wait]:
    tasks = TaskSet()

    async def wait(polls: LongPolls, *followers: bytes) -> list[asyncio.Task[None]]:
        begun = [tasks.spawn(polls.wait(LONG, each), "follower") for each in followers]
        await until(lambda: len(polls) == len(followers))
        return begun

    yield wait
    await tasks.close()


async def test_a_change_wakes_every_follower(waiting: Wait) -> None:
    polls = LongPolls()
    tasks = await waiting(polls, b"a", b"b")
    polls.notify(7)
    async with asyncio.timeout(LONG / 2):
        await asyncio.gather(*tasks)
    assert len(polls) == 0


async def test_a_version_that_was_notified_wakes_nobody(waiting: Wait) -> None:
    polls = LongPolls()
    polls.notify(7)
    (task,) = await waiting(polls, b"a")
    polls.notify(7)
    await asyncio.sleep(0.15)
    assert not task.done()
    polls.notify()  # rights or lists
    async with asyncio.timeout(LONG / 2):
        await task


async def test_a_new_call_ends_the_one_before_of_its_key_only(waiting: Wait) -> None:
    polls = LongPolls()
    first, other = await waiting(polls, b"a", b"b")
    polls.wake((b"a",))
    polls.wake((b"nobody",))
    async with asyncio.timeout(LONG / 2):
        await first
    assert not other.done()
    other.cancel()
    await asyncio.gather(other, return_exceptions=True)
    assert len(polls) == 0


async def test_a_wait_ends_without_a_change() -> None:
    polls = LongPolls()
    await polls.wait(0.01, b"a")
    assert len(polls) == 0


async def test_what_changed_between_two_calls_is_told_with_the_second() -> None:
    polls = LongPolls(0.0)
    assert polls.missed(b"a")  # nothing was told so far
    assert not polls.missed(b"a")
    polls.notify()
    assert polls.missed(b"a")
    assert not polls.missed(b"a")
    task = asyncio.ensure_future(polls.wait(LONG, b"a"))
    await asyncio.sleep(0)
    polls.notify()
    await task
    assert not polls.missed(b"a")  # its answer followed


async def test_a_change_between_the_call_and_its_first_step_counts() -> None:
    polls = LongPolls()
    wait = polls.wait(LONG, b"a", polls.expect(b"a"))
    polls.notify(1)
    async with asyncio.timeout(LONG / 2):
        await wait
    assert len(polls) == 0


async def test_what_a_caller_did_not_wait_for_is_forgotten() -> None:
    polls = LongPolls()
    expected = polls.expect(b"a")
    polls.forget(expected, b"a")
    polls.forget(expected, b"a")
    assert len(polls) == 0


async def test_a_change_for_one_key_ends_its_waits_only(waiting: Wait) -> None:
    polls = LongPolls(0.0)
    *own, other = await waiting(polls, ONE, ONE, TWO)
    polls.wake([ONE, b"3" * 32])
    async with asyncio.timeout(LONG / 2):
        await asyncio.gather(*own)
    assert not other.done()
    assert len(polls) == 1
    other.cancel()
    await asyncio.wait([other])
    assert len(polls) == 0, "nothing is left of a call whose connection ended"


async def test_of_too_many_waits_of_one_key_the_oldest_ends(waiting: Wait) -> None:
    polls = LongPolls(0.0, 3)
    first, *rest = await waiting(polls, ONE, ONE, ONE)
    last = asyncio.ensure_future(polls.wait(LONG, ONE))
    async with asyncio.timeout(LONG / 2):
        await first
    assert not any(task.done() for task in (*rest, last))
    assert len(polls) == 3
    polls.wake([ONE])
    async with asyncio.timeout(LONG / 2):
        await asyncio.gather(*rest, last)
