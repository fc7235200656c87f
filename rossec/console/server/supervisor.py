"""The console as a command: sockets that listen, the web process behind them, its end. A shell.

It has what the web process must not have: the terminal, and the right to start processes. It reads
nothing that browsers send; pictures go on to the scanner's process unread.

The supervisor's side: takes pictures of the web process, and runs the worker that decodes them.

One picture at a time. A worker that takes too long, breaks the protocol or dies is killed, and the
next picture gets a new one; one that has nothing to do for a while ends.

The supervisor's side of the preview: starts its process beside each web process. A shell.

The two talk over a socketpair of their own, which the supervisor gives away: it reads no message.

The supervisor's side of the web process: starts it, feeds it, starts it again. A shell.

It is executed anew, so that nothing of the supervisor's memory is in it; it inherits sockets: those
that listen, which outlive it, and its ends of two socketpairs. Whoever was logged in logs in again.
"""

import asyncio
import logging
import os
import pwd
import socket
import subprocess
import sys
from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import nullcontext, suppress
from pathlib import Path
from typing import Final, NamedTuple

from rossec import clock
from rossec.authority.keyservice import messages
from rossec.authority.keyservice.process import CREDENTIALS
from rossec.console.listening import listen
from rossec.console.options import Endpoint
from rossec.console.preview.receiver import NAME
from rossec.console.scanning import frames
from rossec.console.scanning.frames import Found, Unreadable
from rossec.console.server import control
from rossec.console.server.control import IDLE, LIFETIME, ON_THE_WALL, Settings, write_settings
from rossec.enrollment.scanner import CLOSER
from rossec.errors import ConfigurationError, KeyMessageRefused
from rossec.home import NodeHome
from rossec.host.runner import reap, stop_on_signals, until_first_ends

WORKER: Final = (sys.executable, "-I", "-m", "rossec.console.scanning.worker")
DEADLINE: Final = 4.0  # seconds for a picture
SCANNER_START: Final = 20.0  # seconds more for the first picture of a worker
SCANNER_IDLE: Final = 60.0  # seconds without a picture after which a worker ends
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
        idle: float = SCANNER_IDLE,
    ) -> None:
        self._socket = sock
        self._command = command
        self._deadline = deadline
        self._idle = idle
        self._worker: asyncio.subprocess.Process | None = None

    async def run(self) -> None:
        reader, writer = await asyncio.open_connection(sock=self._socket)
        try:
            while True:
                try:
                    async with asyncio.timeout(self._idle):
                        head = await reader.readexactly(frames.HEAD)
                except TimeoutError:
                    await self._end()
                    head = await reader.readexactly(frames.HEAD)
                picture = await reader.readexactly(frames.size(head, frames.MAX_PICTURE))
                writer.write(frames.write_answer(await self._read(picture)))
                await writer.drain()
        except (asyncio.IncompleteReadError, ConnectionError):
            return
        finally:
            writer.transport.abort()
            await self._end()

    async def _read(self, picture: bytes) -> Found | Unreadable:
        try:
            worker, limit = self._worker, self._deadline
            if worker is None:
                worker, limit = await self._start(), self._deadline + SCANNER_START
            async with asyncio.timeout(limit):
                return await _exchange(worker, picture)
        except (OSError, TimeoutError, asyncio.IncompleteReadError, KeyMessageRefused) as error:
            _log.warning("a picture was not read: %r", error)
            await self._end()
            return _SLOW

    async def _start(self) -> asyncio.subprocess.Process:
        self._worker = await asyncio.create_subprocess_exec(
            *self._command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={},
            start_new_session=True,  # Ctrl-C is for the supervisor, which ends it
        )
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


RECEIVER_MODULE: Final = "rossec.console.preview.receiver"
_END: Final = 5.0  # seconds between the end of the connection and SIGKILL
_supervisor_log = logging.getLogger("rossec.console")


def check_enrolled(home: Path) -> None:
    """Return if the node `/console` has an identity in ROSSEC_HOME `home`."""
    node = NodeHome.of(home, NAME)
    if not (node.path / "node.pem").exists():
        raise ConfigurationError(
            f"--preview receives as the node {NAME}, which is not enrolled here",
            f"rossec node request {NAME}, rossec ca sign FILE, rossec node install FILE;"
            f" then grant it what pages may show: rossec grant sign {NAME} --subscribe TOPIC",
        )
    node.identity(clock.now())


class PreviewProcess:
    """The process of the preview; one at a time.

    Args:
        environ: of the node.
        module: that is run.
    """

    def __init__(self, environ: Mapping[str, str], module: str = RECEIVER_MODULE) -> None:
        self._environ = dict(environ)
        self._command = (sys.executable, "-I", "-m", module)
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def pid(self) -> int | None:
        return None if self._process is None else self._process.pid

    def start(self) -> socket.socket:
        """Start it; returns the end of its socketpair that is for the pages."""
        theirs, pages = socket.socketpair()
        with theirs:
            self._process = subprocess.Popen(  # noqa: S603 - this program's own module
                [*self._command, str(theirs.fileno())],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                pass_fds=[theirs.fileno()],
                env=self._environ,
                start_new_session=True,  # Ctrl-C is for the supervisor, which ends it
            )
        return pages

    async def end(self) -> None:
        """Reap it: it ends with the connection, or is killed."""
        process, self._process = self._process, None
        if process is None:
            return
        try:
            await asyncio.to_thread(process.wait, _END)
        except subprocess.TimeoutExpired:
            _supervisor_log.warning("the preview does not end; it is killed")
        finally:
            process.kill()
            process.wait()


MODULE: Final = "rossec.console.server.web"
START: Final = 30.0  # seconds until it serves
MAX_DELAY: Final = 60.0
END: Final = 5.0  # seconds between the end of the connection and SIGKILL
_web_process_log = logging.getLogger("rossec.console")

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
        return None if self._process is None else self._process.pid

    async def run(self) -> None:
        delay = 0.5
        while True:
            begin = asyncio.get_running_loop().time()
            try:
                await self._run_once()
            except KeyMessageRefused as error:
                _web_process_log.error("the web process breaks the protocol: %s", error)
            finally:
                await self._end()
            lasted = asyncio.get_running_loop().time() - begin
            delay = 1.0 if lasted > MAX_DELAY else min(MAX_DELAY, 2 * delay)
            _web_process_log.error("the web process ended; it is started again in %.0f s", delay)
            await asyncio.sleep(delay)

    async def started(self) -> None:
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
        ours, theirs = socket.socketpair()
        scanner, other = socket.socketpair()
        messages_end = None if self._preview is None else self._preview.start()
        inherited = [theirs, other, *([messages_end] if messages_end else []), *self._listening]
        descriptors = [sock.fileno() for sock in inherited]
        options = self._options
        arguments = (
            ",".join(map(str, descriptors)),
            write_settings(options.settings),
            str(options.service),
            "plain" if self._certificates is None else "tls",
            options.log,
            "preview" if messages_end else "made-up",
        )
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


def settings_for(endpoint: Endpoint, domain: str) -> Settings:
    """The web process's settings: on localhost only this user's programs may connect."""
    own, is_localhost = frozenset({os.geteuid()}), endpoint.is_local and not endpoint.unix_path
    return Settings(
        domain,
        (endpoint.origin,),
        users=own if is_localhost else None,
        proxy_users=own | _users(endpoint.proxy_user) if endpoint.unix_path else frozenset(),
        hsts=endpoint.hsts,
        read_only=endpoint.read_only,
        lifetime=ON_THE_WALL if endpoint.read_only else LIFETIME,
        idle=ON_THE_WALL if endpoint.read_only else IDLE,
    )


def _users(name: str | None) -> frozenset[int]:
    if name is None:
        return frozenset()
    try:
        return frozenset({pwd.getpwnam(name).pw_uid})
    except KeyError:
        raise ConfigurationError(
            f"there is no user {name!a} on this host", "--proxy-user is the user of the proxy"
        ) from None


async def supervise(
    endpoint: Endpoint,
    options: WebOptions,
    environ: Mapping[str, str],
    ready: Callable[[], None],
    certificates: Certificates | None = None,
    preview: PreviewProcess | None = None,
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
