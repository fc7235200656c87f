"""The supervisor's side of the web process: starts it, feeds it, starts it again. A shell.

It is executed anew, so that nothing of the supervisor's memory is in it; it inherits sockets: those
that listen, which outlive it, and its ends of two socketpairs. Whoever was logged in logs in again.
"""

import asyncio
import logging
import socket
import subprocess
import sys
from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Final, NamedTuple

from rossec.authority.keyservice import messages
from rossec.authority.keyservice.face_process import CREDENTIALS
from rossec.console.preview.supervisor import PreviewProcess
from rossec.console.scanning.supervisor import ScannerSupervisor
from rossec.console.server import control
from rossec.console.settings import Settings, write_settings
from rossec.errors import ConfigurationError, KeyMessageRefused
from rossec.operation.reaping import reap
from rossec.operation.shutdown import until_first_ends

MODULE: Final = "rossec.console.server.web"
START: Final = 30.0  # seconds until it serves
MAX_DELAY: Final = 60.0
END: Final = 5.0  # seconds between the end of the connection and SIGKILL
_log = logging.getLogger("rossec.console")

Certificates = Callable[[Callable[[bytes], Awaitable[None]]], Awaitable[None]]
"""Given a function that installs a bundle (key and chain, PEM), installs the first one and then
every newer one, for ever."""


class WebOptions(NamedTuple):
    """What it serves; `service` is the path of the service's socket for the console."""

    settings: Settings
    service: Path
    log: str = "text"


class WebProcess:
    """The web process, from the first start to the end of the supervisor.

    Args:
        options: of the process.
        listening: sockets that listen.
        environ: its environment.
        certificates: for TLS; None: plain HTTP.
        preview: receives messages for its pictures; None: nothing does.
    """

    def __init__(
        self,
        options: WebOptions,
        listening: Sequence[socket.socket],
        environ: Mapping[str, str],
        certificates: Certificates | None = None,
        module: str = MODULE,
        preview: PreviewProcess | None = None,
    ) -> None:
        self._preview = preview
        self._options, self._listening = options, listening
        self._environ = {name: text for name, text in environ.items() if name != CREDENTIALS}
        self._certificates = certificates
        self._command = (sys.executable, "-I", "-m", module)
        self._process: subprocess.Popen[bytes] | None = None
        self._started: asyncio.Future[None] | None = None

    @property
    def pid(self) -> int | None:
        """The process that runs now."""
        return None if self._process is None else self._process.pid

    async def run(self) -> None:
        """Keep one running until this is cancelled."""
        delay = 0.5
        while True:
            begin = asyncio.get_running_loop().time()
            try:
                await self._run_once()
            except KeyMessageRefused as error:
                _log.error("the web process breaks the protocol: %s", error)
            finally:
                await self._end()
            lasted = asyncio.get_running_loop().time() - begin
            delay = 1.0 if lasted > MAX_DELAY else min(MAX_DELAY, 2 * delay)
            _log.error("the web process ended; it is started again in %.0f s", delay)
            await asyncio.sleep(delay)

    async def started(self) -> None:
        """Wait until the first one serves.

        Raises:
            ConfigurationError: it does not.
        """
        try:
            async with asyncio.timeout(START):
                await self._future()
        except TimeoutError as error:
            raise ConfigurationError(
                "the console's web process does not start", "its messages are above"
            ) from error

    async def _run_once(self) -> None:
        ours, scanner = self._spawn()
        pictures = ScannerSupervisor(scanner)
        reader, writer = await asyncio.open_connection(sock=ours)
        tasks = [self._listen(reader), pictures.run()]
        if self._certificates is not None:
            tasks.append(self._install(self._certificates, writer))
        try:
            await until_first_ends(*tasks)
        except ConnectionError:
            return
        finally:
            writer.transport.abort()

    def _spawn(self) -> tuple[socket.socket, socket.socket]:
        """Start the process; returns our ends of the socketpairs."""
        ours, theirs = socket.socketpair()
        scanner, other = socket.socketpair()
        messages_end = None if self._preview is None else self._preview.start()
        inherited = [theirs, other, *([messages_end] if messages_end else []), *self._listening]
        descriptors = [sock.fileno() for sock in inherited]
        options = self._options
        arguments = (
            ",".join(map(str, descriptors)), write_settings(options.settings),
            str(options.service), "plain" if self._certificates is None else "tls", options.log,
            "preview" if messages_end else "made-up",
        )  # fmt: skip
        with theirs, other, messages_end or nullcontext():
            self._process = subprocess.Popen(  # noqa: S603 - this program's own module
                [*self._command, *arguments],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                pass_fds=descriptors,
                env=self._environ,
                start_new_session=True,  # Ctrl-C is for the supervisor, which ends it
            )
        return ours, scanner

    async def _listen(self, reader: asyncio.StreamReader) -> None:
        """Take what it says, until it ends."""
        try:
            while True:
                head = await reader.readexactly(messages.HEAD)
                size = messages.frame_size(head, control.MAX_FRAME)
                if control.read(await reader.readexactly(size)).word != control.READY:
                    raise KeyMessageRefused("the web process says what is not for it to say")
                if not self._future().done():
                    self._future().set_result(None)
        except (asyncio.IncompleteReadError, ConnectionError):
            return

    async def _install(self, certificates: Certificates, writer: asyncio.StreamWriter) -> None:
        async def install(bundle: bytes) -> None:
            writer.write(control.write(control.ControlMessage(control.CERTIFICATE, (bundle,))))
            await writer.drain()

        await certificates(install)

    async def _end(self) -> None:
        """Reap it: it ends with the connection, or is killed."""
        await self._end_process()
        if self._preview is not None:
            await self._preview.end()

    async def _end_process(self) -> None:
        process = self._process
        if process is None:
            return
        try:
            await reap(process, END)
        finally:
            self._process = None

    def _future(self) -> asyncio.Future[None]:
        if self._started is None:
            self._started = asyncio.get_running_loop().create_future()
        return self._started
