"""The web process's side: has a picture read by the scanner process. A shell.

One picture at a time for the whole console, and a few a second: a camera sends the next one anyway,
and whoever has a session shall not occupy the machine with it.
"""

import asyncio
import socket
from typing import Final

from rossec.console.scanning import frames
from rossec.console.scanning.frames import Unreadable
from rossec.errors import KeyMessageRefused, PictureRefused, ScannerBusy

INTERVAL: Final = 0.15  # seconds between two pictures
TIMEOUT: Final = 30.0  # the supervisor answers earlier
_PASTE: Final = "paste the text below the code instead"


class ScannerClient:
    """The scanner behind `sock`, this process's end of the socketpair."""

    def __init__(self, sock: socket.socket, interval: float = INTERVAL) -> None:
        self._socket = sock
        self._interval = interval
        self._lock = asyncio.Lock()
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
        if self._lock.locked():
            raise ScannerBusy("another picture is being read", "wait a moment")
        async with self._lock:
            answer = await self._ask(picture)
            await asyncio.sleep(self._interval)
        if isinstance(answer, Unreadable):
            raise PictureRefused(answer.message, answer.hint)
        return answer.text or None

    async def close(self) -> None:
        """End the connection, and with it the worker."""
        self._ended = True
        if self._streams is None:
            self._socket.close()
            return
        self._streams[1].transport.abort()
        await asyncio.sleep(0)

    async def _ask(self, picture: bytes) -> frames.Found | Unreadable:
        if self._ended:
            raise PictureRefused("pictures cannot be read any more", _PASTE)
        try:
            async with asyncio.timeout(TIMEOUT):
                return await self._exchange(picture)
        except BaseException as error:  # an answer that comes late would be the next picture's
            await self.close()
            if isinstance(error, OSError | EOFError | KeyMessageRefused):
                raise PictureRefused("pictures cannot be read any more", _PASTE) from error
            raise

    async def _exchange(self, picture: bytes) -> frames.Found | Unreadable:
        if self._streams is None:
            self._streams = await asyncio.open_connection(sock=self._socket)
        reader, writer = self._streams
        writer.write(frames.frame(picture))
        await writer.drain()
        head = await reader.readexactly(frames.HEAD)
        body = await reader.readexactly(frames.size(head, frames.MAX_ANSWER))
        return frames.read_answer(body)
