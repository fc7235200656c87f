"""Processes of this program with few rights, as the one that starts them sees them. A shell.

A worker is a module of its own, executed anew, so nothing of the memory and the modules' paths of whoever
starts it is in it. It has the descriptors that it is given and no other, and a session of its own: Ctrl-C is
for the starter, which ends it. It confines itself before the first byte of a stranger comes (`confinement`).
Frames are a length (4 bytes, network byte order) and so many bytes.
"""

import asyncio
import logging
import socket
import subprocess
import sys
from collections.abc import Awaitable, Callable, Coroutine, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from rossec.errors import KeyMessageRefused
from rossec.host.confinement import confine_files, confine_processes

HEAD: Final = 4
MAX_DELAY: Final = 60.0


def worker_command(module: str) -> tuple[str, ...]:
    return sys.executable, "-I", "-m", module


def start_worker(
    command: Sequence[str], environ: Mapping[str, str], descriptors: Sequence[int] = (), **options: Any
) -> "subprocess.Popen[bytes]":
    """Start `command`, which inherits `descriptors`; `options` are those of Popen."""
    # Nothing of a stranger's bytes reaches the terminal or the starter's input; errors do, as a log.
    streams: dict[str, Any] = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL}
    return subprocess.Popen(  # noqa: S603 - this program's own module
        command, pass_fds=descriptors, env=dict(environ), start_new_session=True, **(streams | options)
    )


class AskedWorker:
    """A worker that is asked at its standard input: one frame there, one frame back.

    It is started and ended without waiting for anything, so nothing of it can be left behind by a task that
    is cancelled meanwhile. What is asked may be cancelled; after that, and after any exception, it is of no
    more use and must be closed.
    """

    def __init__(self, command: Sequence[str], **options: Any) -> None:
        self._socket, theirs = socket.socketpair()
        with theirs:
            try:
                self._process = start_worker(command, {}, stdin=theirs, stdout=theirs, **options)
            except BaseException:
                self._socket.close()
                raise
        self._socket.setblocking(False)

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def has_ended(self) -> bool:
        return self._process.poll() is not None

    async def ask(self, request: bytes, size: Callable[[bytes], int]) -> bytes:
        """The answer to a request, a whole frame; `size` checks the head of the answer."""
        await asyncio.get_running_loop().sock_sendall(self._socket, request)
        return await self.receive(size)

    async def receive(self, size: Callable[[bytes], int]) -> bytes:
        return await self._exactly(size(await self._exactly(HEAD)))

    async def _exactly(self, size: int) -> bytes:
        found, loop = bytearray(), asyncio.get_running_loop()
        while len(found) < size:
            piece = await loop.sock_recv(self._socket, size - len(found))
            if not piece:
                raise asyncio.IncompleteReadError(bytes(found), size)
            found += piece
        return bytes(found)

    def close(self) -> None:
        self._socket.close()
        self._process.kill()
        self._process.wait()


async def read_frame(reader: asyncio.StreamReader, size: Callable[[bytes], int]) -> bytes:
    """The body of the next frame; `size` reads its head, and refuses what is too long."""
    return await reader.readexactly(size(await reader.readexactly(HEAD)))


async def keep_running(
    name: str, log: logging.Logger, run: Callable[[], Awaitable[None]], end: Callable[[], Awaitable[None]]
) -> None:
    """Run a worker and `end` it, again and again: each time later, unless it ran for long."""
    time, delay = asyncio.get_running_loop().time, 0.5
    while True:
        begin = time()
        try:
            await run()
        except KeyMessageRefused as error:
            log.error("the %s breaks the protocol: %s", name, error)  # noqa: TRY400 - it says all
        finally:
            await end()
        # Twice as long each time: a worker that cannot start must not keep a processor busy.
        delay = 1.0 if time() - begin > MAX_DELAY else min(MAX_DELAY, 2 * delay)
        log.error("the %s ended; it is started again in %.0f s", name, delay)
        await asyncio.sleep(delay)


def run_confined(main: Callable[[], Coroutine[Any, Any, None]], own: Sequence[Path] = ()) -> None:
    """In the worker: run `main`, which reads `own` and what programs need, writes and starts nothing."""
    confine_files(own)
    # Threads for names of hosts exist before new ones are forbidden: the loop would start them later.
    executor = confine_processes()

    async def run() -> None:
        asyncio.get_running_loop().set_default_executor(executor)
        await main()

    asyncio.run(run())
