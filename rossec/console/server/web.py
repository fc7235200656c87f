"""The web process: serves pages to browsers, and has nothing that signs, records or starts.

`python -I -m rossec.console.server.web`, started by `supervisor`. It talks to strangers, so it is confined
before the first byte comes: it opens no file but programs' own, starts no process, and the service's key
socket refuses it. What it may do is what `console.sock` offers. It ends when the supervisor does.
"""

import asyncio
import logging
import os
import socket
import ssl
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

from rossec import clock
from rossec.authority.console.client import ConsoleClient
from rossec.console import scanning
from rossec.console.app import create_app
from rossec.console.context import ConsoleContext
from rossec.console.samples import PreviewMemory, preview_size, read_preview
from rossec.console.server import control
from rossec.console.server.serving import ConsoleServer
from rossec.errors import ConfigurationError, KeyMessageRefused, RossecError, ScannerBusy
from rossec.host.runner import TaskSet, log_as_json
from rossec.host.sandbox import protect_memory
from rossec.host.workers import read_frame, run_confined

INTERVAL: Final = 0.15  # seconds between two pictures
TIMEOUT: Final = 30.0  # for one; the supervisor answers earlier
_SWEEP: Final = 5.0  # seconds between two looks for messages that are old
_PASTE: Final = "paste the text below the code instead"
_log = logging.getLogger("rossec.console")


def main(arguments: list[str]) -> None:
    # Descriptors of the supervisor, the scanner, perhaps the preview, and those that listen; then settings,
    # the path of the service, `plain` or `tls`, the form of the log, `preview` or `made-up`.
    descriptors, settings, service, tls, log, pictures = arguments
    if log == "json":
        log_as_json()
    else:  # as the service itself writes, whose terminal or journal this is
        logging.basicConfig(level=logging.WARNING, format="rossec: %(levelname)s: %(message)s")
    protect_memory()

    async def run() -> None:
        supervisor, scanner, *listening = (socket.socket(fileno=int(each)) for each in descriptors.split(","))
        context = make_context() if tls == "tls" else None
        preview = listening.pop(0) if pictures == "preview" else None
        process = WebServer(
            control.read_settings(settings), ConsoleClient(Path(service)), scanner, context, preview
        )
        await process.run(supervisor, listening)

    run_confined(run)


class WebServer:
    def __init__(
        self,
        settings: control.WebSettings,
        client: ConsoleClient,
        scanner: socket.socket,
        context: ssl.SSLContext | None = None,
        preview: socket.socket | None = None,
    ) -> None:
        self._client, self._tls = client, context
        self._scanner = ScannerClient(scanner)
        self._preview = None if preview is None else PreviewClient(preview)
        self._context = ConsoleContext(client, settings, self._scanner, self._preview)
        self._server = ConsoleServer(create_app(self._context), context, settings.proxy_users, settings.users)

    async def run(self, supervisor: socket.socket, listening: Sequence[socket.socket]) -> None:
        reader, writer = await asyncio.open_connection(sock=supervisor)
        try:
            if self._tls is not None:
                await self._obey(reader)  # the first certificate
            await self._server.start(listening)
            if self._preview is not None:
                self._preview.start()
            writer.write(control.write(control.ControlMessage(control.READY)))
            await writer.drain()
            while True:
                await self._obey(reader)
        except (asyncio.IncompleteReadError, ConnectionError):
            return
        finally:
            writer.transport.abort()
            await self._server.close()
            await self._context.news.close()
            await self._context.enrollments.close()
            await self._scanner.close()
            if self._preview is not None:
                await self._preview.close()
            await self._client.close()

    async def _obey(self, reader: asyncio.StreamReader) -> None:
        match control.read(await read_frame(reader, control.frame_size)):
            case control.ControlMessage(control.CERTIFICATE, (bytes() as bundle,)) if self._tls is not None:
                load_bundle(self._tls, bundle)
            case other:
                raise ConfigurationError(f"the supervisor says {other.word}, which is not for here")


def make_context() -> ssl.SSLContext:
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    context.set_alpn_protocols(["http/1.1"])
    return context


def load_bundle(context: ssl.SSLContext, bundle: bytes) -> None:
    # This process may open no file that has a key, and OpenSSL reads files alone: one in memory
    # (memfd_create(2)). Connections from now on get it, as all have this one context.
    descriptor = os.memfd_create("tls", os.MFD_CLOEXEC)
    try:
        os.write(descriptor, bundle)
        context.load_cert_chain(f"/proc/self/fd/{descriptor}")
    except (ssl.SSLError, OSError) as error:
        raise ConfigurationError(
            f"the console's certificate cannot be used: {error}", "give another one"
        ) from error
    finally:
        os.close(descriptor)


class ScannerClient:
    """Has pictures read by the scanner process: one at a time for the whole console, a few a second."""

    # A camera sends the next one anyway, and whoever has a session shall not occupy the machine with it.

    def __init__(self, sock: socket.socket, interval: float = INTERVAL) -> None:
        self._socket = sock
        self._interval = interval
        self._tasks = TaskSet()
        self._is_busy = False
        self._next = 0.0  # when the next picture may be read
        self._streams: tuple[asyncio.StreamReader, asyncio.StreamWriter] | None = None
        self._ended = False

    async def read(self, picture: bytes) -> str | None:
        if not 0 < len(picture) <= scanning.MAX_PICTURE:
            raise RossecError(f"a picture has at most {scanning.MAX_PICTURE // 1024} kB here", _PASTE)
        if self._is_busy:
            raise ScannerBusy("another picture is being read", "wait a moment")
        answer: asyncio.Future[scanning.Answer | None] = asyncio.get_running_loop().create_future()
        self._is_busy = True
        # A task of its own: whoever asks may go away, and the next answer is the next picture's.
        self._tasks.spawn(self._work(picture, answer), name="a picture")
        match await answer:
            case scanning.Found(text):
                return text or None
            case scanning.Unreadable(message, hint):
                raise RossecError(message, hint)
            case _:
                raise RossecError("pictures cannot be read any more", _PASTE)

    async def close(self) -> None:
        self._ended = True
        await self._tasks.close()
        if self._streams is None:
            self._socket.close()
        else:
            self._streams[1].transport.abort()
            await asyncio.sleep(0)

    async def _work(self, picture: bytes, answer: asyncio.Future[scanning.Answer | None]) -> None:
        loop = asyncio.get_running_loop()
        try:
            await asyncio.sleep(max(0.0, self._next - loop.time()))
            found = None if self._ended else await self._ask(picture)
        finally:
            self._is_busy = False
            self._next = loop.time() + self._interval
        if not answer.done():
            answer.set_result(found)

    async def _ask(self, picture: bytes) -> scanning.Answer | None:
        try:
            async with asyncio.timeout(TIMEOUT):
                if self._streams is None:
                    self._streams = await asyncio.open_connection(sock=self._socket)
                reader, writer = self._streams
                writer.write(scanning.frame(picture))
                await writer.drain()
                return scanning.read_answer(await read_frame(reader, scanning.answer_size))
        except (OSError, EOFError, KeyMessageRefused):
            # An answer that comes late would be taken for the next picture's: nothing is read any more.
            # The text below the code can still be pasted.
            self._ended = True
            if self._streams is not None:
                self._streams[1].transport.abort()
            return None


class PreviewClient:
    """Takes messages from the process of the preview."""

    def __init__(self, sock: socket.socket, now: Callable[[], float] = clock.time) -> None:
        self._socket = sock
        self._memory = PreviewMemory(now)
        self._tasks = TaskSet()
        self.recorded = self._memory.recorded

    def start(self) -> None:
        self._tasks.spawn(self._take(), "preview of the console")
        self._tasks.spawn(self._sweep(), "end of the preview's minute")

    async def close(self) -> None:
        await self._tasks.close()
        self._socket.close()

    async def _take(self) -> None:
        reader, writer = await asyncio.open_connection(sock=self._socket)
        try:
            while True:
                self._memory.add(read_preview(await read_frame(reader, preview_size)))
        except KeyMessageRefused as error:
            _log.error("the preview breaks the protocol: %s", error)
        except (asyncio.IncompleteReadError, ConnectionError):
            _log.warning("the preview has ended")  # what came fades within a minute: pages make it up again
        finally:
            writer.transport.abort()

    async def _sweep(self) -> None:
        while True:
            await asyncio.sleep(_SWEEP)
            self._memory.drop_old()


if __name__ == "__main__":
    main(sys.argv[1:])
