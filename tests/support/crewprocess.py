"""A crew (`tests.support.crew`) as a process: what its nodes do, and when messages arrived."""

import asyncio
import contextlib
import itertools
import json
import sys
import time
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Final

from tests.support.crew import PERIOD
from tests.support.witness import until

ROOT: Final = Path(__file__).resolve().parents[2]
PATIENCE: Final = 30.0  # seconds


class NotDone(Exception):
    """A node was refused what it was told to do; the text is the error and its hint."""


class CrewProcess:
    """Nodes of one host; messages of (node, topic): `arrivals` their times, `heard` the data."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self.process = process
        self.arrivals: dict[tuple[str, str], list[float]] = defaultdict(list)
        self.heard: dict[tuple[str, str], list[str]] = defaultdict(list)
        self._answers: dict[int, asyncio.Future[object]] = {}
        self._numbers = itertools.count(1)
        self._reading = asyncio.ensure_future(self._read())

    @classmethod
    async def started(cls, prefix: Sequence[str], environ: Mapping[str, str], log: Path) -> "CrewProcess":
        """Start a crew; commands of `prefix` come before its own."""
        with log.open("ab") as errors:
            process = await asyncio.create_subprocess_exec(
                *prefix,
                sys.executable,
                "-m",
                "tests.support.crew",
                env={**environ, "PYTHONPATH": str(ROOT)},
                limit=1 << 24,
                stdin=asyncio.subprocess.PIPE,
                stdout=asyncio.subprocess.PIPE,
                stderr=errors,
            )
        return cls(process)

    async def do(self, node: str, what: str, *given: object) -> object:
        """Have `node` do something, see `tests.support.crew.Crew`; the answer.

        Raises:
            NotDone: it was refused.
        """
        assert self.process.stdin is not None
        number = next(self._numbers)
        answer = self._answers[number] = asyncio.get_running_loop().create_future()
        order = {"id": number, "node": node, "do": what, "with": given}
        self.process.stdin.write(json.dumps(order).encode() + b"\n")
        async with asyncio.timeout(PATIENCE):
            return await answer

    async def publish(self, node: str, *topics: str) -> None:
        for topic in topics:
            await self.do(node, "publish", topic)

    async def subscribe(self, node: str, *topics: str) -> None:
        for topic in topics:
            await self.do(node, "subscribe", topic)

    async def hears(self, node: str, topic: str, within: float = PATIENCE) -> float:
        """Wait for the next message; its time."""
        heard = self.arrivals[node, topic]
        before = len(heard)
        await until(lambda: len(heard) > before, within)
        return heard[-1]

    async def falls_silent(self, node: str, topic: str, within: float = PATIENCE) -> float:
        """Wait until no message has come for a second; the time of the last one."""
        heard = self.arrivals[node, topic]
        await until(lambda: bool(heard) and time.time() - heard[-1] > 1, within)
        return heard[-1]

    def longest_gap(self, node: str, topic: str, since: float) -> float:
        """Seconds without a message, between `since` and now."""
        times = [at for at in self.arrivals[node, topic] if at >= since]
        moments = [since, *times, time.time()]
        return max(after - before for before, after in itertools.pairwise(moments)) - PERIOD

    async def close(self) -> None:
        """Kill it."""
        with contextlib.suppress(ProcessLookupError):
            self.process.kill()
        await self.process.wait()
        await self._reading

    async def _read(self) -> None:
        assert self.process.stdout is not None
        while line := await self.process.stdout.readline():
            said = json.loads(line)
            if "topic" in said:
                self.arrivals[said["node"], said["topic"]].append(said["at"])
                self.heard[said["node"], said["topic"]].append(said["data"])
            else:
                self._answered(said)
        for answer in self._unanswered():
            answer.set_exception(NotDone("the crew ended"))

    def _answered(self, said: Mapping[str, object]) -> None:
        answer = self._answers.pop(int(str(said["id"])))
        if answer.done():
            return
        if "error" in said:
            answer.set_exception(NotDone(f"{said['error']}; {said['hint']}"))
        else:
            answer.set_result(said["answer"])

    def _unanswered(self) -> Iterable[asyncio.Future[object]]:
        return [answer for answer in self._answers.values() if not answer.done()]
