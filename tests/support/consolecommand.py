"""`rossec console` as a process beside `rossec ca serve`."""

import json
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlsplit

from tests.support.serviceprocess import ServiceProcess


@dataclass
class Console:
    """A console that runs, and what it said."""

    process: subprocess.Popen[str]
    said: dict[str, Any]

    @property
    def code(self) -> str:
        return urlsplit(str(self.said["login"])).fragment


@contextmanager
def console(service: ServiceProcess, *options: str) -> Iterator[Console]:
    """`rossec console OPTIONS`, ended afterwards; it ends well."""
    process = subprocess.Popen(
        [sys.executable, "-I", "-m", "rossec", "console", "--json", *options],
        env=service.environ,
        text=True,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
    )
    assert process.stdout is not None
    try:
        line = process.stdout.readline()
        assert line, process.wait(30)
        yield Console(process, json.loads(line))
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == 0
    finally:
        process.kill()
        process.wait()
        process.stdout.close()
