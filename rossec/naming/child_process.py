"""One process that applies rules, as the loop that asks it sees it. A shell.

It is started and ended without waiting for anything, so nothing of it can be left behind by a task
that is cancelled meanwhile; what is asked may be cancelled, and then the process is of no more use.
"""

import asyncio
import socket
import subprocess
import sys
from collections.abc import Sequence
from typing import Final, Self

from rossec.errors import RossecError, RulesExceeded, RulesNotConfined
from rossec.naming import frames

CHILD: Final = (sys.executable, "-I", "-m", "rossec.naming.child")
START: Final = 20.0  # seconds until it is confined


class RuleProcess:
    """A process that answers one request after the other; close it in any case."""

    def __init__(self, process: "subprocess.Popen[bytes]", sock: socket.socket) -> None:
        self._process = process
        self._socket = sock
        self._is_ready = False

    @classmethod
    def start(cls, command: Sequence[str] = CHILD) -> Self:
        """Start one: with a socket to here, no environment, and nothing else of this process.

        Raises:
            RulesNotConfined: it cannot be started.
        """
        own, other = socket.socketpair()
        with other:
            try:
                process = subprocess.Popen(  # noqa: S603 - the own interpreter and module
                    command,
                    stdin=other.fileno(), stdout=other.fileno(), stderr=subprocess.DEVNULL,
                    env={}, cwd="/", start_new_session=True,  # Ctrl-C is for this process
                )  # fmt: skip
            except OSError as error:
                own.close()
                raise RulesNotConfined(f"the process for rules does not start: {error}") from error
        own.setblocking(False)
        return cls(process, own)

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    @property
    def has_ended(self) -> bool:
        """Whether it ended by itself, or was ended by somebody else."""
        return self._process.poll() is not None

    async def ask(self, body: bytes, seconds: float) -> bytes:
        """The body of the answer to a request. After any exception the process must be closed.

        Raises:
            RulesExceeded: no answer within `seconds`, one too long, or the process ended.
            RulesNotConfined: it could not be confined.
        """
        await self._wait_until_ready()
        try:
            async with asyncio.timeout(seconds):
                await asyncio.get_running_loop().sock_sendall(self._socket, frames.frame(body))
                return await self._receive()
        except TimeoutError:
            raise RulesExceeded(f"the rules took longer than {seconds:g} s") from None
        except OSError as error:
            raise RulesExceeded("the process for rules ended") from error

    def close(self) -> None:
        """End it, at once; what it does for a request ends with it."""
        self._socket.close()
        self._process.kill()
        self._process.wait()

    async def _wait_until_ready(self) -> None:
        if self._is_ready:
            return
        hint = "run python -m rossec.naming.child to see why"
        try:
            async with asyncio.timeout(START):
                first = await self._receive()
        except (OSError, RulesExceeded) as error:  # TimeoutError is an OSError
            raise RulesNotConfined("the process for rules does not start", hint) from error
        if first != frames.READY:
            raise _refusal(first)
        self._is_ready = True

    async def _receive(self) -> bytes:
        head = await self._exactly(frames.HEAD)
        return await self._exactly(frames.size(head, frames.MAX_ANSWER))

    async def _exactly(self, size: int) -> bytes:
        found, loop = bytearray(), asyncio.get_running_loop()
        while len(found) < size:
            piece = await loop.sock_recv(self._socket, size - len(found))
            if not piece:
                raise RulesExceeded("the process for rules ended")
            found += piece
        return bytes(found)


def _refusal(first: bytes) -> RossecError:
    """What the process says instead of being ready."""
    try:
        frames.read_names(first, 0)
    except RossecError as error:
        return error
    return RulesNotConfined("the process for rules says nothing of being confined")
