"""Secured rospy programs as separate processes, with their input."""

import asyncio
import contextlib
import sys
from collections.abc import AsyncIterator, Callable, Mapping
from pathlib import Path
from typing import Final

from grants.model import Right
from tests.support import stock
from tests.support.site import Site

PROJECT: Final = Path(__file__).resolve().parents[2]
SECURE: Final = "import rossec\nrossec.secure()\n"


def environment(site: Site, logs: Path, **more: str) -> dict[str, str]:
    """The environment of a program of this site; `logs` is rospy's log directory."""
    assert site.master is not None
    return {**stock.environment(site.master.uri, logs), **site.environ, "PYTHONPATH": str(PROJECT), **more}


def entitle(site: Site, name: str, rights: Mapping[Right, tuple[str, ...]]) -> None:
    """Enroll `name` and sign a grant for each of these rights."""
    site.enroll(name)
    for right, patterns in rights.items():
        for pattern in patterns:
            site.grant(name, right, pattern)


class Program:
    """A running program, and all its output."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self.process = process
        self.said = ""

    async def read_until(self, words: str, within: float = 30.0) -> str:
        """Read until a line contains `words`; return it."""
        assert self.process.stdout is not None
        async with asyncio.timeout(within):
            while True:
                line = (await self.process.stdout.readline()).decode()
                assert line, f"it ended without saying {words!r}, but: {self.said}"
                self.said += line
                if words in line:
                    return line.rstrip("\n")

    async def ends(self, within: float = 30.0) -> int:
        """Read to the end; the exit code."""
        assert self.process.stdout is not None
        async with asyncio.timeout(within):
            self.said += (await self.process.stdout.read()).decode()
            return await self.process.wait()

    async def tell(self, line: str) -> None:
        """Write a line to its standard input."""
        assert self.process.stdin is not None
        self.process.stdin.write(f"{line}\n".encode())
        await self.process.stdin.drain()


@contextlib.asynccontextmanager
async def program(
    env: Mapping[str, str], source: str, *arguments: str, told: bool = False
) -> AsyncIterator[Program]:
    """Run Python `source`, with or without standard input; it is stopped afterwards."""
    process = await asyncio.create_subprocess_exec(
        *stock.python(source, *arguments),
        env=dict(env),
        limit=1 << 20,
        stdin=asyncio.subprocess.PIPE if told else asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.STDOUT,
    )
    running = Program(process)
    try:
        yield running
    except BaseException:
        _signal(process.kill)
        assert process.stdout is not None
        sys.stderr.write(running.said + (await process.stdout.read()).decode())
        raise
    finally:
        await _end(process)


async def _end(process: asyncio.subprocess.Process) -> None:
    """With an interrupt first, so that coverage is written."""
    if process.returncode is None:
        _signal(process.terminate)
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(5):
                await process.communicate()
    if process.returncode is None:
        _signal(process.kill)
    await process.communicate()


def _signal(send: Callable[[], None]) -> None:
    with contextlib.suppress(ProcessLookupError):  # it has just exited
        send()
