"""The supervisor's side: takes pictures of the web process, and runs the worker that decodes them.

One picture at a time. A worker that takes too long, breaks the protocol or dies is killed, and the
next picture gets a new one; one that has nothing to do for a while ends.
"""

import asyncio
import logging
import socket
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from typing import Final

from rossec.console.scanning import frames
from rossec.console.scanning.frames import Found, Unreadable
from rossec.enrollment.scanner import CLOSER
from rossec.errors import KeyMessageRefused

WORKER: Final = (sys.executable, "-I", "-m", "rossec.console.scanning.worker")
DEADLINE: Final = 4.0  # seconds for a picture
START: Final = 20.0  # seconds more for the first picture of a worker
IDLE: Final = 60.0  # seconds without a picture after which a worker ends
_SLOW: Final = Unreadable("reading the picture took too long, or failed", CLOSER)
_log = logging.getLogger("rossec.console.scanner")


class ScannerSupervisor:
    """Answers the web process.

    Args:
        sock: the supervisor's end of the socketpair.
        command: of the worker.
        deadline: seconds for a picture.
        idle: seconds without a picture after which a worker ends.
    """

    def __init__(
        self,
        sock: socket.socket,
        command: Sequence[str] = WORKER,
        deadline: float = DEADLINE,
        idle: float = IDLE,
    ) -> None:
        self._socket = sock
        self._command = command
        self._deadline = deadline
        self._idle = idle
        self._worker: asyncio.subprocess.Process | None = None

    async def run(self) -> None:
        """Answer until the web process ends its end.

        Raises:
            KeyMessageRefused: it breaks the protocol.
        """
        reader, writer = await asyncio.open_connection(sock=self._socket)
        try:
            while True:
                picture = await self._next(reader)
                writer.write(frames.write_answer(await self._read(picture)))
                await writer.drain()
        except (asyncio.IncompleteReadError, ConnectionError):
            return
        finally:
            writer.transport.abort()
            await self._end()

    async def _next(self, reader: asyncio.StreamReader) -> bytes:
        """The next picture; while none comes, no worker is kept for longer than `idle`."""
        try:
            async with asyncio.timeout(self._idle):
                head = await reader.readexactly(frames.HEAD)
        except TimeoutError:
            await self._end()
            head = await reader.readexactly(frames.HEAD)
        return await reader.readexactly(frames.size(head, frames.MAX_PICTURE))

    async def _read(self, picture: bytes) -> Found | Unreadable:
        try:
            worker, limit = self._worker, self._deadline
            if worker is None:
                worker, limit = await self._start(), self._deadline + START
            async with asyncio.timeout(limit):
                return await _exchange(worker, picture)
        except (OSError, TimeoutError, asyncio.IncompleteReadError, KeyMessageRefused) as error:
            _log.warning("a picture was not read: %r", error)
            await self._end()
            return _SLOW

    async def _start(self) -> asyncio.subprocess.Process:
        self._worker = await asyncio.create_subprocess_exec(
            *self._command,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            env={}, start_new_session=True,  # Ctrl-C is for the supervisor, which ends it
        )  # fmt: skip
        return self._worker

    async def _end(self) -> None:
        worker, self._worker = self._worker, None
        if worker is None:
            return
        with suppress(ProcessLookupError):
            worker.kill()
        await worker.wait()


async def _exchange(worker: asyncio.subprocess.Process, picture: bytes) -> Found | Unreadable:
    assert worker.stdin is not None  # noqa: S101 - both are pipes
    assert worker.stdout is not None  # noqa: S101
    worker.stdin.write(frames.frame(picture))
    await worker.stdin.drain()
    head = await worker.stdout.readexactly(frames.HEAD)
    body = await worker.stdout.readexactly(frames.size(head, frames.MAX_ANSWER))
    return frames.read_answer(body)
