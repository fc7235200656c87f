import asyncio
import os
import signal

import pytest

from rossec.host.runner import stop_on_signals, until_first_ends


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
async def test_a_signal_sets_the_event(number: signal.Signals) -> None:
    stop = stop_on_signals()
    try:
        assert not stop.is_set()
        os.kill(os.getpid(), number)
        async with asyncio.timeout(10):
            await stop.wait()
    finally:
        for each in (signal.SIGINT, signal.SIGTERM):
            asyncio.get_running_loop().remove_signal_handler(each)


async def test_the_first_task_that_ends_cancels_the_others() -> None:
    cancelled = asyncio.Event()

    async def endless() -> None:
        try:
            await asyncio.Event().wait()
        finally:
            cancelled.set()

    async with asyncio.timeout(10):
        await until_first_ends(endless(), asyncio.sleep(0.01))
        await cancelled.wait()


async def test_what_the_first_task_raises_is_raised() -> None:
    async def failing() -> None:
        raise OSError("the address is gone")

    with pytest.raises(OSError, match="gone"):
        await until_first_ends(failing(), asyncio.Event().wait())
