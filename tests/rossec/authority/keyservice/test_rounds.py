"""Scheduler of the service: every so often, at once when woken, and always all tasks."""

import asyncio
import threading
from collections.abc import Callable

import pytest

from rossec.authority.keyservice import network as module
from rossec.authority.keyservice.network import Scheduler
from tests.support.witness import until


async def in_thread(task: Callable[[], None]) -> None:
    await asyncio.to_thread(task)


async def ended(running: "asyncio.Future[None]") -> None:
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)


async def test_rounds_go_on_and_tasks_keep_their_order(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "ROUND", 0.01)
    done: list[str] = []
    rounds = Scheduler(in_thread)
    rounds.add(lambda: done.append("last"))
    rounds.add(lambda: done.append("first"), first=True)
    running = asyncio.ensure_future(rounds.run())
    await until(lambda: len(done) >= 6)
    await ended(running)
    assert done[:6] == ["first", "last"] * 3


async def test_a_reason_begins_a_round_at_once_also_during_another() -> None:
    begun, go_on = threading.Semaphore(0), threading.Semaphore(0)

    def task() -> None:
        begun.release()
        go_on.acquire(timeout=10)

    rounds = Scheduler(in_thread)
    rounds.wake()  # nothing runs yet: the first round comes anyhow
    rounds.add(task)
    running = asyncio.ensure_future(rounds.run())
    for _ in range(3):
        assert await asyncio.to_thread(begun.acquire, timeout=10)
        await asyncio.to_thread(rounds.wake)  # during the round
        go_on.release()
    assert await asyncio.to_thread(begun.acquire, timeout=10)
    go_on.release()
    await asyncio.sleep(0.05)
    assert not begun.acquire(blocking=False), "without a reason there is no other round now"
    await ended(running)


async def test_a_task_that_crashes_keeps_no_other_from_being_done(caplog: pytest.LogCaptureFixture) -> None:
    done: list[int] = []
    rounds = Scheduler(in_thread)
    rounds.add(lambda: done.append(1 // 0))
    rounds.add(lambda: done.append(1))
    running = asyncio.ensure_future(rounds.run())
    await until(lambda: done == [1])
    rounds.wake()
    await until(lambda: done == [1, 1])
    await ended(running)
    assert caplog.text.count("a round of the authority failed") == 2


def test_waking_after_the_end_does_nothing() -> None:
    rounds = Scheduler(in_thread)

    async def run() -> None:
        await ended(asyncio.ensure_future(rounds.run()))

    asyncio.run(run())
    rounds.wake()
