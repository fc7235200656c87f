"""What the demo runs in: a printer of steps, commands as a user would type them, and processes.

A process reports on stdout, which is stored; what it logs goes to a file. Every
wait has a deadline, and everything that was started is stopped.
"""

import asyncio
import contextlib
import io
import json
import os
import re
import shlex
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from rossec.errors import RossecError

DEADLINE: Final = 15.0
_LOOK: Final = 0.05  # seconds between two looks at a log
PATIENCE: Final = 3.0  # seconds a process has to end when asked
Report = dict[str, Any]
# Runs one command line in an environment, returns its exit code (`rossec.cli.main.run`).
Run = Callable[[Sequence[str], Mapping[str, str]], int]


class DemoFailed(RossecError):
    pass


class StepPrinter:
    def __init__(self, write: Callable[[str], object]) -> None:
        self._write = write
        self._step = 0

    @contextlib.contextmanager
    def step(self, title: str) -> Iterator[None]:
        self._step += 1
        self._write(f"\n{self._step:2}. {title}\n")
        begin = time.perf_counter()
        yield
        self._write(f"    done in {time.perf_counter() - begin:.2f} s\n")

    def print(self, text: str) -> None:
        for line in text.splitlines():
            self._write(f"    {line}\n")


class DemoEnvironment:
    def __init__(self, root: Path, printer: StepPrinter, variables: dict[str, str], run: Run) -> None:
        self.root, self.printer, self.run = root, printer, run
        self._environment = {**os.environ, **variables, "ROSSEC_HOME": str(root)}
        self._processes: list[DemoProcess] = []

    async def command(self, *arguments: str, quiet: bool = False) -> str:
        self.printer.print(f"$ rossec {self._relative(shlex.join(arguments))}")
        code, output = await asyncio.to_thread(self._run, arguments)
        if code:
            raise DemoFailed(f"rossec {' '.join(arguments[:2])} failed: {output}")
        if not quiet:
            self.printer.print(self._relative(output))
        return output

    def _run(self, arguments: tuple[str, ...]) -> tuple[int, str]:
        out = io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
            code = self.run(list(arguments), self._environment)
        return code, out.getvalue()

    def set(self, variable: str, value: str) -> None:
        self._environment[variable] = value

    async def start(self, module: str, *arguments: str, name: str) -> "DemoProcess":
        log = self.root / "logs" / f"{name}.log"
        log.parent.mkdir(mode=0o700, exist_ok=True)
        with log.open("ab") as errors:
            command = (sys.executable, "-I", "-m", module, *arguments)
            nothing, pipe = asyncio.subprocess.DEVNULL, asyncio.subprocess.PIPE
            process = await asyncio.create_subprocess_exec(
                *command, env=self._environment, stdin=nothing, stdout=pipe, stderr=errors
            )
        started = DemoProcess(name, process, log)
        self._processes.append(started)
        return started

    async def until_one_ends(self) -> None:
        waiting = [asyncio.ensure_future(each.wait()) for each in self._processes]
        try:
            await asyncio.wait(waiting, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in waiting:
                task.cancel()
        ended = next(each for each in self._processes if each.ended)
        raise DemoFailed(f"{ended.name} has ended; it logged: {ended.last_lines()}")

    async def stop_all(self) -> None:
        for process in reversed(self._processes):
            await process.stop()

    def _relative(self, text: str) -> str:
        return text.replace(str(self.root), "$ROSSEC_HOME")


class DemoProcess:
    def __init__(self, name: str, process: asyncio.subprocess.Process, log: Path) -> None:
        self.name = name
        self.reports: list[Report] = []
        self._process = process
        self._log = log
        self.ended = False
        self._changed = asyncio.Condition()
        self._reader = asyncio.get_running_loop().create_task(self._read())

    async def expect(
        self, what: str, wanted: Callable[[Report], bool], *, after: int = 0, within: float = DEADLINE
    ) -> Report:
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(within), self._changed:
                await self._changed.wait_for(lambda: self._find(wanted, after) or self.ended)
        found = self._find(wanted, after)
        if found is None:
            raise DemoFailed(f"{self.name}: {what} did not happen; it logged: {self.last_lines()}")
        return found

    async def logged(self, pattern: str, within: float = DEADLINE) -> str:
        end = time.monotonic() + within
        while True:
            has_ended = self.ended  # before the look: what it wrote last counts
            found = re.search(pattern, self._log.read_text(errors="replace"), re.MULTILINE)
            if found is not None:
                return found[0]
            if has_ended or time.monotonic() > end:
                raise DemoFailed(f"{self.name} said nothing expected: {self.last_lines()}")
            await asyncio.sleep(_LOOK)

    async def wait(self) -> None:
        async with self._changed:
            await self._changed.wait_for(lambda: self.ended)

    def about(self, topic: str) -> list[Report]:
        return [report for report in self.reports if report.get("topic") == topic]

    async def stop(self) -> None:
        # Terminate the process; kill it when it does not end.
        if self._process.returncode is None:
            self._process.terminate()
            try:
                await asyncio.wait_for(self._process.wait(), PATIENCE)
            except TimeoutError:
                self._process.kill()
                await self._process.wait()
        await self._reader

    async def _read(self) -> None:
        stdout = self._process.stdout
        while stdout is not None and (line := await stdout.readline()):
            async with self._changed:
                self.reports.append(json.loads(line))
                self._changed.notify_all()
        async with self._changed:
            self.ended = True
            self._changed.notify_all()

    def _find(self, wanted: Callable[[Report], bool], after: int) -> Report | None:
        return next((report for report in self.reports[after:] if wanted(report)), None)

    def last_lines(self) -> str:
        lines = self._log.read_text(errors="replace").strip().splitlines()
        return " / ".join(lines[-3:]) or "nothing"
