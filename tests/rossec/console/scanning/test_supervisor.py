"""The supervisor's side: workers that answer, hang, die or lie."""

import asyncio
import os
import socket
import sys
import time
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from ca.enrollment import qr
from rossec.console import scanning
from rossec.console.server.supervisor import WORKER, ScannerSupervisor
from rossec.console.server.web import ScannerClient
from rossec.errors import KeyMessageRefused, RossecError

TEXT = qr.label_code(b"a request")
LIAR = "import sys; sys.stdout.buffer.write(bytes(4)); sys.stdout.flush(); sys.stdin.read()"
# Answers every picture with its own process id.
SIMPLE = """
import os, sys
from rossec.console import scanning
from rossec.console.scanning import Found
scanning.serve(sys.stdin.buffer, sys.stdout.buffer, lambda picture: Found(str(os.getpid())))
"""


def program(text: str) -> Sequence[str]:
    return (sys.executable, "-c", text)


def gone(process: str) -> None:
    while Path("/proc", process).exists():
        time.sleep(0.01)


@asynccontextmanager
async def scanner(
    command: Sequence[str], *, deadline: float = 20.0, idle: float = 60.0
) -> AsyncIterator[ScannerClient]:
    ours, theirs = socket.socketpair()
    supervisor = ScannerSupervisor(ours, command, deadline, idle)
    client = ScannerClient(theirs, interval=0.0)
    async with asyncio.TaskGroup() as group:
        group.create_task(supervisor.run())
        yield client
        await client.close()


async def test_a_picture_is_read_by_the_worker() -> None:
    async with scanner(WORKER) as client:
        assert await client.read(qr.png(TEXT)) == TEXT


async def test_one_worker_reads_many_pictures() -> None:
    async with scanner(program(SIMPLE)) as client:
        assert len({await client.read(b"x") for _ in range(5)}) == 1


async def test_a_worker_that_is_idle_ends_and_another_one_takes_its_place() -> None:
    async with scanner(program(SIMPLE), idle=0.05) as client:
        first = await client.read(b"x")
        assert first is not None
        await asyncio.to_thread(gone, first)
        assert await client.read(b"x") != first


@pytest.mark.parametrize(
    "command",
    [program("import time; time.sleep(600)"), program(LIAR), program(""), ("/no/such/program",)],
    ids=["hangs", "lies", "dies", "missing"],
)
async def test_a_worker_that_fails_is_one_picture_that_was_not_read(
    command: Sequence[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rossec.console.server.supervisor.SCANNER_START", 0.0)
    deadline = 0.3 if "time" in command[-1] else 20.0
    async with scanner(command, deadline=deadline) as client:
        for _ in range(2):
            with pytest.raises(RossecError, match="took too long, or failed"):
                await client.read(b"x")


async def test_a_web_process_that_breaks_the_protocol_is_not_served() -> None:
    ours, theirs = socket.socketpair()
    with theirs:
        theirs.sendall((scanning.MAX_PICTURE + 1).to_bytes(4))
        with pytest.raises(KeyMessageRefused):
            await ScannerSupervisor(ours).run()


async def test_no_worker_outlives_the_web_process() -> None:
    async with scanner(program(SIMPLE)) as client:
        worker = await client.read(b"x")
    with pytest.raises(ProcessLookupError):
        os.kill(int(worker or 0), 0)
