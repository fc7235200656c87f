"""The web process's side: has a picture read by the scanner process. A shell.

One picture at a time for the whole console, and a few a second: a camera sends the next one anyway,
and whoever has a session shall not occupy the machine with it.
"""

import asyncio
import socket
from typing import Final, TypeAlias

from rossec.console.scanning import frames
from rossec.console.scanning.frames import Found, Unreadable
from rossec.errors import KeyMessageRefused, PictureRefused, ScannerBusy
from rossec.net.aio.tasks import TaskSet

INTERVAL: Final = 0.15  # seconds between two pictures
TIMEOUT: Final = 30.0  # the supervisor answers earlier
_PASTE: Final = "paste the text below the code instead"
Answer: TypeAlias = Found | Unreadable


class ScannerClient:
    """The scanner behind `sock`, this process's end of the socketpair."""

    def __init__(self, sock: socket.socket, interval: float = INTERVAL) -> None:
        self._socket = sock
        self._interval = interval
        self._tasks = TaskSet()
        self._is_busy = False
        self._next = 0.0  # when the next picture may be read
        self._streams: tuple[asyncio.StreamReader, asyncio.StreamWriter] | None = None
        self._ended = False

    async def read(self, picture: bytes) -> str | None:
        """The text of the one code in a picture; None: there is none in it.

        Raises:
            PictureRefused: too large, several codes, not a picture, or it took too long.
            ScannerBusy: another picture is being read.
        """
        if not 0 < len(picture) <= frames.MAX_PICTURE:
            raise PictureRefused(
                f"a picture has at most {frames.MAX_PICTURE // 1024} kB here", _PASTE
            )
        if self._is_busy:
            raise ScannerBusy("another picture is being read", "wait a moment")
        answer: asyncio.Future[Answer | None] = asyncio.get_running_loop().create_future()
        self._is_busy = True
        # A task of its own: whoever asks may go away, and the next answer is the next picture's.
        self._tasks.spawn(self._work(picture, answer), name="a picture")
        match await answer:
            case Found(text):
                return text or None
            case Unreadable(message, hint):
                raise PictureRefused(message, hint)
            case _:
                raise PictureRefused("pictures cannot be read any more", _PASTE)

    async def close(self) -> None:
        """End the connection, and with it the worker."""
        self._ended = True
        await self._tasks.close()
        if self._streams is None:
            self._socket.close()
        else:
            self._streams[1].transport.abort()
            await asyncio.sleep(0)

    async def _work(self, picture: bytes, answer: asyncio.Future[Answer | None]) -> None:
        """Have a picture read, some time after the one before; None: nobody reads any more."""
        loop = asyncio.get_running_loop()
        try:
            await asyncio.sleep(max(0.0, self._next - loop.time()))
            found = None if self._ended else await self._ask(picture)
        finally:
            self._is_busy = False
            self._next = loop.time() + self._interval
        if not answer.done():
            answer.set_result(found)

    async def _ask(self, picture: bytes) -> Answer | None:
        try:
            async with asyncio.timeout(TIMEOUT):
                return await self._exchange(picture)
        except (OSError, EOFError, KeyMessageRefused):
            self._ended = True
            if self._streams is not None:
                self._streams[1].transport.abort()
            return None

    async def _exchange(self, picture: bytes) -> Answer:
        if self._streams is None:
            self._streams = await asyncio.open_connection(sock=self._socket)
        reader, writer = self._streams
        writer.write(frames.frame(picture))
        await writer.drain()
        head = await reader.readexactly(frames.HEAD)
        body = await reader.readexactly(frames.size(head, frames.MAX_ANSWER))
        return frames.read_answer(body)
