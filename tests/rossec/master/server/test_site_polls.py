"""Followers wait for changes of the registrations; a newer call ends the one before."""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable

import pytest

from rossec.host.runner import TaskSet
from rossec.master.server.updates import SitePolls
from tests.rossec.master.world import until

LONG = 30.0

Wait = Callable[..., Awaitable[list[asyncio.Task[None]]]]


@pytest.fixture
async def waiting() -> AsyncIterator[Wait]:
    tasks = TaskSet()

    async def wait(polls: SitePolls, *followers: bytes) -> list[asyncio.Task[None]]:
        begun = [tasks.spawn(polls.wait(each, LONG), "follower") for each in followers]
        await until(lambda: len(polls) == len(followers))
        return begun

    yield wait
    await tasks.close()


async def test_a_change_wakes_every_follower(waiting: Wait) -> None:
    polls = SitePolls()
    tasks = await waiting(polls, b"a", b"b")
    polls.notify(7)
    async with asyncio.timeout(LONG / 2):
        await asyncio.gather(*tasks)
    assert len(polls) == 0


async def test_a_version_that_was_notified_wakes_nobody(waiting: Wait) -> None:
    polls = SitePolls()
    polls.notify(7)
    (task,) = await waiting(polls, b"a")
    polls.notify(7)
    await asyncio.sleep(0.15)
    assert not task.done()
    polls.notify()  # rights or lists
    async with asyncio.timeout(LONG / 2):
        await task


async def test_a_new_call_ends_the_one_before_of_its_key_only(waiting: Wait) -> None:
    polls = SitePolls()
    first, other = await waiting(polls, b"a", b"b")
    polls.supersede(b"a")
    polls.supersede(b"nobody")
    async with asyncio.timeout(LONG / 2):
        await first
    assert not other.done()
    other.cancel()
    await asyncio.gather(other, return_exceptions=True)
    assert len(polls) == 0


async def test_a_wait_ends_without_a_change() -> None:
    polls = SitePolls()
    await polls.wait(b"a", 0.01)
    assert len(polls) == 0


async def test_what_changed_between_two_calls_is_told_with_the_second() -> None:
    polls = SitePolls(0.0)
    assert polls.missed(b"a")  # nothing was told so far
    assert not polls.missed(b"a")
    polls.notify()
    assert polls.missed(b"a")
    assert not polls.missed(b"a")
    task = asyncio.ensure_future(polls.wait(b"a", LONG))
    await asyncio.sleep(0)
    polls.notify()
    await task
    assert not polls.missed(b"a")  # its answer followed


async def test_a_change_between_the_call_and_its_first_step_counts() -> None:
    polls = SitePolls()
    wait = polls.wait(b"a", LONG, polls.expect(b"a"))
    polls.notify(1)
    async with asyncio.timeout(LONG / 2):
        await wait
    assert len(polls) == 0
