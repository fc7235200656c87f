"""The programs of a measurement, as processes on the hosts of a network; all end with it."""

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from tests.support.hosts import Host

ROOT: Final = Path(__file__).resolve().parents[2]
PATIENCE: Final = 60.0  # seconds until a program is ready


class Program:
    """A running program that prints lines of JSON."""

    def __init__(self, process: "subprocess.Popen[bytes]", log: Path) -> None:
        self.process, self._log = process, log
        self._rest = b""

    @property
    def pid(self) -> int:
        return self.process.pid

    def tell(self, **order: object) -> None:
        """Give an order."""
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps(order).encode() + b"\n")

    def ask(self, seconds: float = PATIENCE, **order: object) -> Any:
        """Give an order, and wait for its answer."""
        self.tell(**order)
        return self.answer(seconds)

    def answer(self, seconds: float = PATIENCE) -> Any:
        """The next answer."""
        return json.loads(self.line(seconds))["answer"]

    def line(self, seconds: float = PATIENCE) -> bytes:
        """The next line that it prints."""
        assert self.process.stdout is not None
        end = time.monotonic() + seconds
        while b"\n" not in self._rest:
            readable, _, _ = select.select([self.process.stdout], [], [], end - time.monotonic())
            data = os.read(self.process.stdout.fileno(), 1 << 20) if readable else b""
            if not data:
                why = "ended" if readable else "says nothing"
                last = self._log.read_text().splitlines()[-5:]
                raise RuntimeError(f"{self._log.stem} {why}:\n" + "\n".join(last))
            self._rest += data
        line, _, self._rest = self._rest.partition(b"\n")
        return line

    def signal(self, number: signal.Signals) -> None:
        """Send a signal."""
        self.process.send_signal(number)


class Programs:
    """Starts programs; `directory` has their logs and files."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self._stack = contextlib.ExitStack()
        self._started = 0

    def start(self, name: str, host: Host, environ: Mapping[str, str], *command: str) -> Program:
        """Start a program on a host."""
        self._started += 1
        log = self.directory / f"{name}.{self._started}.log"
        kept = {key: value for key, value in os.environ.items() if not key.startswith("ROS")}
        own = {"PYTHONPATH": str(ROOT), "PYTHONUNBUFFERED": "1", "PYTHONWARNINGS": "ignore"}
        with log.open("wb") as errors:
            process = subprocess.Popen(
                host.at(*command),
                env={**kept, **own, **environ},
                bufsize=0,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors,
                start_new_session=True,
            )
        self._stack.callback(_end, process)
        return Program(process, log)

    def rossec(self, host: Host, environ: Mapping[str, str], *words: str) -> Program:
        """Start a command of rossec."""
        return self.start(words[0], host, environ, sys.executable, "-m", "rossec", *words)

    def close(self) -> None:
        """End them all."""
        self._stack.close()


def _end(process: "subprocess.Popen[bytes]") -> None:
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)  # its own session: roscore has children
    process.wait()
    for pipe in (process.stdin, process.stdout):
        assert pipe is not None
        with contextlib.suppress(OSError):
            pipe.close()


@contextlib.contextmanager
def programs(directory: Path) -> Iterator[Programs]:
    """Programs that end with the block."""
    made = Programs(directory)
    try:
        yield made
    finally:
        made.close()
