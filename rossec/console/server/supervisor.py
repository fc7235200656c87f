"""The console as a command: sockets that listen, the processes behind them, and their end. A shell.

The supervisor has what the web process must not have: the terminal, and the right to start processes. It
reads nothing that browsers send. When the web process is started again, whoever was logged in logs in again.
"""

import asyncio
import logging
import os
import pwd
import socket
import subprocess
from collections.abc import Awaitable, Callable, Coroutine, Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any, Final, NamedTuple

from rossec import clock
from rossec.authority.keyservice.process import CREDENTIALS
from rossec.console import scanning
from rossec.console.listening import listen
from rossec.console.options import ConsoleEndpoint
from rossec.console.preview import NAME
from rossec.console.server import control
from rossec.enrollment import CLOSER
from rossec.errors import ConfigurationError, KeyMessageRefused
from rossec.home import NodeHome
from rossec.host.runner import reap, stop_on_signals, until_first_ends
from rossec.host.workers import AskedWorker, keep_running, read_frame, start_worker, worker_command

MODULE: Final = "rossec.console.server.web"
START: Final = 30.0  # seconds until it serves
END: Final = 5.0  # seconds between the end of the connection and SIGKILL
RECEIVER_MODULE: Final = "rossec.console.preview"
WORKER: Final = worker_command("rossec.console.scanning")
DEADLINE: Final = 4.0  # seconds for a picture
SCANNER_START: Final = 20.0  # seconds more for the first picture of a worker
SCANNER_IDLE: Final = 60.0  # seconds without a picture after which a worker ends
_SLOW: Final = scanning.Unreadable("reading the picture took too long, or failed", CLOSER)
_log = logging.getLogger("rossec.console")
_scanner_log = logging.getLogger("rossec.console.scanner")

Certificates = Callable[[Callable[[bytes], Awaitable[None]]], Coroutine[Any, Any, None]]
"""Given a function that installs a bundle (key and chain, PEM), installs the first one and then
every newer one, for ever."""


class WebOptions(NamedTuple):
    """What it serves."""

    settings: control.WebSettings
    service: Path  # of the service's socket for the console
    log: str = "text"


async def supervise(
    endpoint: ConsoleEndpoint,
    options: WebOptions,
    environ: Mapping[str, str],
    ready: Callable[[], None],
    certificates: Certificates | None = None,
    preview: "PreviewProcess | None" = None,
) -> None:
    """Run the console until SIGINT or SIGTERM; `ready` is called when it serves."""
    stop = stop_on_signals()
    sockets = listen(endpoint)
    try:
        web = WebProcess(options, sockets, environ, certificates, preview=preview)

        async def until_stopped() -> None:
            await web.started()
            ready()
            await stop.wait()

        await until_first_ends(web.run(), until_stopped(), stop.wait())
    finally:
        for sock in sockets:
            sock.close()
        if endpoint.unix_path is not None:
            endpoint.unix_path.unlink(missing_ok=True)


def settings_for(endpoint: ConsoleEndpoint, domain: str) -> control.WebSettings:
    """The web process's settings: on localhost only this user's programs may connect."""
    own, proxies = frozenset({os.geteuid()}), frozenset[int]()
    if endpoint.unix_path is not None:
        proxies = own
        if endpoint.proxy_user is not None:
            try:
                proxies |= {pwd.getpwnam(endpoint.proxy_user).pw_uid}
            except KeyError:
                said = f"there is no user {endpoint.proxy_user!a} on this host"
                raise ConfigurationError(said, "--proxy-user is the user of the proxy") from None
    return control.WebSettings(
        domain,
        (endpoint.origin,),
        users=own if endpoint.is_local and not endpoint.unix_path else None,
        proxy_users=proxies,
        hsts=endpoint.hsts,
        read_only=endpoint.read_only,
        lifetime=control.ON_THE_WALL if endpoint.read_only else control.LIFETIME,
        idle=control.ON_THE_WALL if endpoint.read_only else control.IDLE,
    )


class WebProcess:
    def __init__(
        self,
        options: WebOptions,
        listening: Sequence[socket.socket],
        environ: Mapping[str, str],
        certificates: Certificates | None = None,
        module: str = MODULE,
        preview: "PreviewProcess | None" = None,
    ) -> None:
        self._preview = preview
        self._options, self._listening = options, listening
        self._environ = {name: text for name, text in environ.items() if name != CREDENTIALS}
        self._certificates = certificates
        self._command = worker_command(module)
        self._process: subprocess.Popen[bytes] | None = None
        self._started = asyncio.Event()

    @property
    def pid(self) -> int | None:
        return None if self._process is None else self._process.pid

    async def run(self) -> None:
        await keep_running("web process", _log, self._run_once, self._end)

    async def started(self) -> None:
        try:
            async with asyncio.timeout(START):
                await self._started.wait()
        except TimeoutError as error:
            said = "the console's web process does not start"
            raise ConfigurationError(said, "its messages are above") from error

    async def _run_once(self) -> None:
        ours, scanner = self._spawn()
        pictures = ScannerSupervisor(scanner)
        reader, writer = await asyncio.open_connection(sock=ours)

        async def install(bundle: bytes) -> None:
            writer.write(control.write(control.ControlMessage(control.CERTIFICATE, (bundle,))))
            await writer.drain()

        tasks: list[Coroutine[Any, Any, None]] = [self._listen(reader), pictures.run()]
        tasks += [] if self._certificates is None else [self._certificates(install)]
        try:
            await until_first_ends(*tasks)
        except ConnectionError:
            return
        finally:
            writer.transport.abort()

    def _spawn(self) -> tuple[socket.socket, socket.socket]:
        # The sockets that listen outlive the process. Pictures go on to the scanner's process unread, and the
        # preview's messages to the pages over a socketpair that is given away.
        ours, theirs = socket.socketpair()
        scanner, other = socket.socketpair()
        messages_end = None if self._preview is None else self._preview.start()
        inherited = [theirs, other, *([messages_end] if messages_end else []), *self._listening]
        descriptors = [sock.fileno() for sock in inherited]
        options = self._options
        arguments = (
            ",".join(map(str, descriptors)),
            control.write_settings(options.settings),
            str(options.service),
            "plain" if self._certificates is None else "tls",
            options.log,
            "preview" if messages_end else "made-up",
        )
        with theirs, other, messages_end or nullcontext():
            self._process = start_worker([*self._command, *arguments], self._environ, descriptors)
        return ours, scanner

    async def _listen(self, reader: asyncio.StreamReader) -> None:
        try:
            while True:
                if control.read(await read_frame(reader, control.frame_size)).word != control.READY:
                    raise KeyMessageRefused("the web process says what is not for it to say")
                self._started.set()
        except (asyncio.IncompleteReadError, ConnectionError):
            return

    async def _end(self) -> None:
        try:
            if self._process is not None:
                await reap(self._process, END)
        finally:
            self._process = None
        if self._preview is not None:
            await self._preview.end()


class ScannerSupervisor:
    """Answers the web process with what the worker that decodes pictures reads, one at a time."""

    # A worker that takes too long, breaks the protocol or dies is killed; the next picture gets a new one.

    def __init__(
        self,
        sock: socket.socket,
        command: Sequence[str] = WORKER,
        deadline: float = DEADLINE,
        idle: float = SCANNER_IDLE,
    ) -> None:
        self._socket, self._command = sock, command
        self._deadline, self._idle = deadline, idle
        self._worker: AskedWorker | None = None

    async def run(self) -> None:
        reader, writer = await asyncio.open_connection(sock=self._socket)
        try:
            while True:
                try:
                    async with asyncio.timeout(self._idle):
                        head = await reader.readexactly(scanning.HEAD)
                except TimeoutError:  # nobody holds a camera now: its memory is given back
                    self._end()
                    head = await reader.readexactly(scanning.HEAD)
                picture = await reader.readexactly(scanning.size(head, scanning.MAX_PICTURE))
                writer.write(scanning.write_answer(await self._read(picture)))
                await writer.drain()
        except (asyncio.IncompleteReadError, ConnectionError):
            return
        finally:
            writer.transport.abort()
            self._end()

    async def _read(self, picture: bytes) -> scanning.Answer:
        limit = self._deadline
        try:
            if self._worker is None:
                # The first picture of a worker waits for its libraries too.
                self._worker, limit = AskedWorker(self._command), self._deadline + SCANNER_START
            async with asyncio.timeout(limit):
                body = await self._worker.ask(scanning.frame(picture), scanning.answer_size)
                return scanning.read_answer(body)
        except (OSError, TimeoutError, asyncio.IncompleteReadError, KeyMessageRefused) as error:
            _scanner_log.warning("a picture was not read: %r", error)
            self._end()
            return _SLOW

    def _end(self) -> None:
        worker, self._worker = self._worker, None
        if worker is not None:
            worker.close()


class PreviewProcess:
    """The process of the preview: `start` gives the socket at which its messages come."""

    def __init__(self, environ: Mapping[str, str], module: str = RECEIVER_MODULE) -> None:
        self._environ = environ
        self._command = worker_command(module)
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def pid(self) -> int | None:
        return None if self._process is None else self._process.pid

    def start(self) -> socket.socket:
        theirs, pages = socket.socketpair()
        with theirs:
            descriptor = theirs.fileno()
            self._process = start_worker([*self._command, str(descriptor)], self._environ, [descriptor])
        return pages

    async def end(self) -> None:
        process, self._process = self._process, None
        if process is None:
            return
        try:
            await asyncio.to_thread(process.wait, END)
        except subprocess.TimeoutExpired:
            _log.warning("the preview does not end; it is killed")
        finally:
            process.kill()
            process.wait()


def check_enrolled(home: Path) -> None:
    """Refuse a home without a valid identity of the preview's node."""
    node = NodeHome.of(home, NAME)
    if not (node.path / "node.pem").exists():
        raise ConfigurationError(
            f"--preview receives as the node {NAME}, which is not enrolled here",
            f"rossec node request {NAME}, rossec ca sign FILE, rossec node install FILE;"
            f" then grant it what pages may show: rossec grant sign {NAME} --subscribe TOPIC",
        )
    node.identity(clock.now())
