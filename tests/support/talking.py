"""Programs that run until the block ends and say, line by line, what they have heard."""

import asyncio
import contextlib
import json
import sys
from collections.abc import AsyncIterator
from typing import Any

from rossec.host.runner import TaskSet

Heard = dict[str, list[Any]]  # by topic: how many, the last number, the gaps


class Talking:
    """A program, and what it says."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self.process = process
        self.heard: Heard = {}
        self.lines: list[str] = []

    async def read(self) -> None:
        assert self.process.stdout is not None
        async for data in self.process.stdout:
            line = data.decode()
            if line.startswith("HEARD "):
                self.heard = json.loads(line.removeprefix("HEARD "))
            else:
                self.lines.append(line)

    @property
    def said(self) -> str:
        return "".join(self.lines)


@contextlib.asynccontextmanager
async def started(env: dict[str, str], *command: str) -> AsyncIterator[Talking]:
    process = await asyncio.create_subprocess_exec(
        *command,
        env=env,
        stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.STDOUT,
        limit=1 << 20,
    )
    running = Talking(process)
    tasks = TaskSet()
    reading = tasks.spawn(running.read(), "what a program says")
    try:
        yield running
    except BaseException:
        sys.stderr.write(running.said)
        raise
    finally:
        with contextlib.suppress(ProcessLookupError):
            process.terminate()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(10):
                await process.wait()
        with contextlib.suppress(ProcessLookupError):
            process.kill()
        await process.wait()
        await reading


@contextlib.asynccontextmanager
async def cancelled() -> AsyncIterator[asyncio.TaskGroup]:
    """Tasks that end with the block."""
    async with asyncio.TaskGroup() as group:
        try:
            yield group
        finally:
            for task in group._tasks:
                task.cancel()
