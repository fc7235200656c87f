"""How child processes end: by themselves, killed when late, killed when nobody waits any more."""

import asyncio
import signal
import subprocess
import sys

import pytest

from rossec.host.runner import reap


def sleeping(seconds: float) -> "subprocess.Popen[bytes]":
    return subprocess.Popen([sys.executable, "-c", f"import time; time.sleep({seconds})"])


async def test_one_that_ends_by_itself_is_reaped() -> None:
    process = sleeping(0)
    await reap(process, 30)
    assert process.returncode == 0


async def test_one_that_does_not_is_killed_by_reap() -> None:
    process = sleeping(60)
    await reap(process, 0.05)
    assert process.returncode == -signal.SIGKILL


async def test_a_cancelled_reap_leaves_no_process() -> None:
    process = sleeping(60)
    with pytest.raises(TimeoutError):
        async with asyncio.timeout(0.05):
            await reap(process, 30)
    assert process.returncode == -signal.SIGKILL
