"""The pages' side of the preview: takes messages from the process that receives them. A shell.

If that process ends, what came fades within a minute, and pages show made-up messages again.
"""

import asyncio
import logging
import socket
from collections.abc import Callable
from typing import Final

from rossec import clock
from rossec.console.preview import frames
from rossec.console.preview.memory import PreviewMemory
from rossec.console.samples import Recorded
from rossec.errors import KeyMessageRefused
from rossec.net.aio.tasks import TaskSet

_SWEEP: Final = 5.0  # seconds between two looks for what is old
_log = logging.getLogger("rossec.console")


class PreviewClient:
    """The preview behind `sock`, this process's end of the socketpair."""

    def __init__(self, sock: socket.socket, now: Callable[[], float] = clock.time) -> None:
        self._socket = sock
        self._memory = PreviewMemory(now)
        self._tasks = TaskSet()

    def recorded(self, topic: str) -> Recorded | None:
        """The last minute of a topic; None if it is not received, or nothing came."""
        return self._memory.recorded(topic)

    def start(self) -> None:
        """Begin to take messages."""
        self._tasks.spawn(self._take(), "preview of the console")
        self._tasks.spawn(self._sweep(), "end of the preview's minute")

    async def close(self) -> None:
        """End it; the receiving process ends with the connection."""
        await self._tasks.close()
        self._socket.close()

    async def _take(self) -> None:
        reader, writer = await asyncio.open_connection(sock=self._socket)
        try:
            while True:
                head = await reader.readexactly(frames.HEAD)
                body = await reader.readexactly(frames.size(head))
                self._memory.add(frames.read(body))
        except KeyMessageRefused as error:
            _log.error("the preview breaks the protocol: %s", error)
        except (asyncio.IncompleteReadError, ConnectionError):
            _log.warning("the preview has ended")
        finally:
            writer.transport.abort()

    async def _sweep(self) -> None:
        while True:
            await asyncio.sleep(_SWEEP)
            self._memory.drop_old()
