import asyncio

import pytest

from rossec.host.runner import TaskSet


async def test_close_ends_every_task() -> None:
    tasks = TaskSet()
    running = [tasks.spawn(asyncio.sleep(60), f"sleeper {i}") for i in range(3)]
    await asyncio.sleep(0)
    await tasks.close()
    assert all(task.cancelled() for task in running)


async def test_a_crash_is_logged_and_reported(caplog: pytest.LogCaptureFixture) -> None:
    crashes: list[BaseException] = []
    tasks = TaskSet(on_crash=crashes.append)

    async def crash() -> None:
        raise ValueError("boom")

    task = tasks.spawn(crash(), "the fragile one")
    await asyncio.wait([task])
    await asyncio.sleep(0)
    assert "the fragile one crashed" in caplog.text
    assert [str(error) for error in crashes] == ["boom"]


async def test_a_task_may_close_its_owner() -> None:
    tasks = TaskSet()
    other = tasks.spawn(asyncio.sleep(60), "other")
    await tasks.spawn(tasks.close(), "closer")
    assert other.cancelled()


async def test_ends_are_silent_without_a_listener(caplog: pytest.LogCaptureFixture) -> None:
    tasks = TaskSet()
    await tasks.spawn(asyncio.sleep(0), "quick")
    await tasks.close()
    assert not caplog.text


async def test_a_task_set_cancels_what_still_runs() -> None:
    tasks = TaskSet()
    running = tasks.spawn(asyncio.sleep(60), name="sleeper")
    assert len(tasks) == 1
    await tasks.close()
    assert running.cancelled()
    assert len(tasks) == 0
