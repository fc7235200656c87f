"""The process that holds the key, while it runs: its socket, time and audit, and the network process.

Every connection to the socket is one caller, admitted by the user id that the kernel reports. The network
process is a worker (`rossec.host.workers`) that inherits its end of a socketpair and no other descriptor.
"""

import asyncio
import logging
import os
import socket
import subprocess
from collections.abc import Awaitable, Callable, Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

from ca.authority import Authority
from ca.encoding import Value
from ca.errors import HintedError
from ca.keys.signing import Signer
from rossec import clock
from rossec.authority.home import AuthorityHome, fingerprint
from rossec.authority.keyservice import messages
from rossec.authority.keyservice.front_end import Handler, InnerChannel
from rossec.authority.keyservice.messages import SOCKET, ServiceRequest
from rossec.authority.keyservice.operations import HeldKey, KeyOperations
from rossec.errors import ConfigurationError, KeyMessageRefused, KeyServiceRefused, PeerUserRefused
from rossec.host import runner, workers
from rossec.host.audit import AUDIT, AuditFile
from rossec.host.local_sockets import UnixPeer, listen_at, raw_socket, require_user, unix_peer
from rossec.peer_limits import printable

_MAX_READ: Final = 4096  # bytes
_MAX_SHOWN: Final = 300  # characters


class AuditedCaller(NamedTuple):
    """A process that asks, as the audit names it."""

    user: int
    process: int
    command: str

    def __str__(self) -> str:
        return f"user {self.user}, process {self.process}: {self.command}"


# What the process says of itself: it can change it, or end and another one get its number. It is evidence
# for a person who reads the audit, and decides nothing.
def caller_of(peer: UnixPeer, proc: Path = Path("/proc")) -> AuditedCaller:
    try:
        with (proc / str(peer.process) / "cmdline").open("rb") as file:
            data = file.read(_MAX_READ)
    except OSError:
        data = b""
    words = data.rstrip(b"\0").replace(b"\0", b" ").decode(errors="replace")
    return AuditedCaller(peer.user, peer.process, printable(words, _MAX_SHOWN) or "(unknown)")


MAX_CALLERS: Final = 64
IDLE: Final = 120.0  # seconds between two requests of a caller
DEADLINE: Final = 10.0  # seconds from the first byte of a request to its last, and for an answer
_log = logging.getLogger("rossec.authority.service")

CarryOut = Callable[[ServiceRequest, AuditedCaller], Awaitable[Value]]


def admit_all(_: UnixPeer) -> None: ...


class SocketRules(NamedTuple):
    """`read_request`: reads the body of a frame. Raises `KeyMessageRefused`. `max_request`: bytes of the
    body. `max_callers`: connections at a time. `users`: who may connect; empty: the user of this
    process.
    """

    read_request: Callable[[bytes], ServiceRequest] = messages.read_request
    max_request: int = messages.MAX_FRAME
    max_callers: int = MAX_CALLERS
    users: Collection[int] = ()


KEY_RULES: Final = SocketRules()


@dataclass(eq=False, repr=False)
class KeyServer:
    """`path`: of the socket; a stale one is replaced, so the caller holds the lock of the service.
    `carry_out`: carries out one request. Raises `HintedError` for a refusal. `admit`: raises
    `PeerUserRefused` for a process that may not ask.
    """

    path: Path
    carry_out: CarryOut
    admit: Callable[[UnixPeer], None] = admit_all
    rules: SocketRules = KEY_RULES

    def __post_init__(self) -> None:
        self._server: asyncio.Server | None = None
        self._callers: set[asyncio.StreamWriter] = set()

    async def start(self) -> None:
        self.path.unlink(missing_ok=True)
        sock = listen_at(self.path)
        if self.rules.users:
            self.path.chmod(0o666)  # the directory, and who connects, decide
        self._server = await asyncio.start_unix_server(self._serve, sock=sock, limit=self.rules.max_request)

    async def close(self) -> None:
        if self._server is not None:
            self._server.close()
            self.path.unlink(missing_ok=True)
        for writer in self._callers:
            writer.transport.abort()
        await asyncio.sleep(0)  # the sockets are closed by then

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._callers.add(writer)
        try:
            with suppress(TimeoutError, OSError, asyncio.IncompleteReadError):
                await self._answer_all(reader, writer)
        except Exception:  # noqa: BLE001 - a check that crashes closes the connection
            _log.exception("a connection to the service ended")
        finally:
            self._callers.discard(writer)
            writer.transport.abort()

    async def _answer_all(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        caller = self._admitted(writer)
        if len(self._callers) > self.rules.max_callers:
            busy = KeyServiceRefused(
                f"{self.rules.max_callers} programs use the authority's service now", "try again"
            )
            await _send(writer, messages.write_refusal(busy))
            return
        while True:
            # `key-socket`: sizes are checked before reading, and time and connections bounded, so that nobody
            # blocks the service. What is malformed is answered with a refusal and ends the connection.
            async with asyncio.timeout(IDLE):
                first = await reader.readexactly(1)
            try:
                async with asyncio.timeout(DEADLINE):
                    limit = self.rules.max_request
                    head = first + await reader.readexactly(messages.HEAD - 1)
                    body = await reader.readexactly(messages.frame_size(head, limit))
                    request = self.rules.read_request(body)
            except KeyMessageRefused as error:
                await _send(writer, messages.write_refusal(error))
                return
            try:
                answer = messages.write_answer(await self.carry_out(request, caller))
            except HintedError as error:
                answer = messages.write_refusal(error)
            await _send(writer, answer)

    def _admitted(self, writer: asyncio.StreamWriter) -> AuditedCaller:
        try:
            sock = raw_socket(writer.get_extra_info("socket"))
            require_user(sock, self.rules.users or {os.geteuid()})
            peer = unix_peer(sock)
            self.admit(peer)
        except PeerUserRefused as error:
            _log.warning("refused at the authority's service: %s", error)
            raise OSError("refused") from error
        return caller_of(peer)


async def _send(writer: asyncio.StreamWriter, data: bytes) -> None:
    writer.write(data)
    async with asyncio.timeout(DEADLINE):
        await writer.drain()


TICK: Final = 1.0  # seconds between two looks at the clock


def operations_of(
    home: AuthorityHome, audit: Callable[[str], None], join_port: Callable[[], int] = int
) -> KeyOperations:
    """The operations on the key of the authority in `home`, which is locked."""
    # `join_port`: where nodes join now; 0: nowhere.
    anchor, own = home.anchor(), home.intermediate()
    subject = anchor.subject if own is None else anchor.read_intermediate(own).subject
    about: dict[int | str, Value] = {
        "domain": anchor.domain,
        "fingerprint": fingerprint(anchor),
        "started": clock.now(),
    }

    def load(secret: str) -> Signer:
        return Authority(home.load_key(secret), anchor.certificate, own).signer

    authority = messages.ServedAuthority(subject, anchor.domain)
    describe = lambda: {**about, "join_port": join_port()}  # noqa: E731 - one expression
    return KeyOperations(HeldKey(load), authority, audit, describe)


def audit_to(file: AuditFile) -> Callable[[str], None]:
    audit = logging.getLogger(AUDIT)

    def write(text: str) -> None:
        audit.info("%s", text)
        if file.is_failing:
            raise KeyServiceRefused(
                "the audit cannot be written, so nothing is signed", "make room on the disk"
            )

    return write


class KeyServiceProcess:
    """`admit`: raises `PeerUserRefused` for a process that may not ask. `phone_code`: makes a code for the
    console, for a caller; audited.
    """

    def __init__(
        self,
        home: AuthorityHome,
        operations: KeyOperations,
        admit: Callable[[UnixPeer], None],
        phone_code: Callable[[AuditedCaller], str] | None = None,
    ) -> None:
        self.operations = operations
        self._phone_code = phone_code
        self._server = KeyServer(home.path / SOCKET, self._carry_out, admit)

    async def start(self) -> None:
        await self._server.start()

    async def close(self) -> None:
        await self._server.close()
        self.operations.held.lock()

    async def watch_time(self) -> None:
        """Drop the key when its time is over, until this is cancelled."""
        # The loop's clock stops while the machine sleeps: so the other one is read every second.
        while True:
            try:
                self.operations.lock_if_over()
            except HintedError as error:  # the key is dropped, only the line is missing
                _log.error("%s", error)
            await asyncio.sleep(TICK)

    async def _carry_out(self, request: ServiceRequest, caller: AuditedCaller) -> Value:
        if request.operation == messages.PHONE_CODE:
            if self._phone_code is None:
                raise KeyServiceRefused("this service has no console", "restart: rossec ca serve")
            return self._phone_code(caller)
        if request.operation == messages.UNLOCK:  # scrypt takes a tenth of a second
            return await asyncio.to_thread(self.operations.carry_out, request, caller)
        return self.operations.carry_out(request, caller)


CREDENTIALS: Final = "CREDENTIALS_DIRECTORY"  # of systemd: the passphrase may be there
MODULE: Final = "rossec.authority.keyservice.front_end"
START: Final = 30.0  # seconds until it listens
_END: Final = 5.0  # seconds between the end of the connection and SIGKILL


class FrontEndOptions(NamedTuple):
    """Where nodes join (`host:port`), the master's URI, and the log's form."""

    join_address: str
    master_uri: str
    log: str = "text"


class FrontEndProcess:
    def __init__(
        self, home: AuthorityHome, options: FrontEndOptions, environ: Mapping[str, str], module: str = MODULE
    ) -> None:
        self.port = 0
        self._command = workers.worker_command(module)
        self._arguments = [str(home.node().path), *options]
        self._environ = {name: text for name, text in environ.items() if name != CREDENTIALS}
        self._handlers: dict[str, Handler] = {}
        self._process: subprocess.Popen[bytes] | None = None
        self._socket: socket.socket | None = None
        self._channel: InnerChannel | None = None
        self._started: asyncio.Future[int] | None = None

    def spawn(self) -> None:
        """Start it; the first one before the service has a key."""
        self._socket, theirs = socket.socketpair()
        with theirs:
            command = [*self._command, str(theirs.fileno()), *self._arguments]
            self._process = workers.start_worker(command, self._environ, [theirs.fileno()])

    def admit(self, peer: UnixPeer) -> None:
        """Raise for the face itself, which may start no other process: it may not ask for keys."""
        if self._process is not None and peer.process == self._process.pid:
            raise PeerUserRefused("the network process may not use the service's socket")

    async def run(self, join: Handler, name: Handler | None = None) -> None:
        """Keep a face running until this is cancelled; `join` and `name` answer its requests."""
        self._handlers = {messages.READY: self._ready, messages.FAILED: self._failed, messages.JOIN: join}
        if name is not None:
            self._handlers[messages.NAME] = name
        await workers.keep_running("network process", _log, self._run_once, self._end)

    async def _run_once(self) -> None:
        if self._socket is None:
            self.spawn()
        assert self._socket is not None  # noqa: S101 - `spawn` made it
        self._channel = InnerChannel(self._socket, self._handlers, messages.MAX_FROM_FACE)
        self._socket = None
        try:
            await self._channel.run()
        finally:
            self._channel = None

    async def _end(self) -> None:
        # Until it is reaped its number is refused at the socket: it may linger without its connection.
        try:
            if self._process is not None:
                await runner.reap(self._process, _END)
        finally:
            self._process = None

    async def started(self) -> int:
        try:
            async with asyncio.timeout(START):
                return await self._future()
        except TimeoutError as error:
            raise ConfigurationError(
                "the network process does not start", "its messages are in the log"
            ) from error

    async def call(self, method: str, arguments: list[Value], within: int) -> Value:
        if self._channel is None:
            raise KeyServiceRefused("the network process does not run", "it is started again")
        operation = messages.CALL
        return await self._channel.call(operation, method, arguments, within, within=within + 1)

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
        if self._process is not None:
            self._process.kill()
            self._process.wait()

    def _future(self) -> asyncio.Future[int]:
        if self._started is None:
            self._started = asyncio.get_running_loop().create_future()
        return self._started

    async def _ready(self, port: int) -> Value:
        self.port = port
        if not self._future().done():
            self._future().set_result(port)
        return None

    async def _failed(self, message: str, hint: str) -> Value:
        _log.error("%s", printable(message))
        if not self._future().done():
            self._future().set_exception(ConfigurationError(printable(message), printable(hint)))
        return None
