"""The service's side of its network face: starts it, answers it, starts it again. A shell.

The face is executed anew, so that nothing of the service's memory is in it, and started first while
the service has no key. Its end of a socketpair is the only descriptor it inherits. A face that dies
is replaced, each time later; one that breaks the protocol is killed before.
"""

import asyncio
import logging
import socket
import subprocess
import sys
from collections.abc import Mapping
from typing import Final, NamedTuple

from ca.encoding import Value
from rossec.authority.home import AuthorityHome
from rossec.authority.keyservice import inner_messages
from rossec.authority.keyservice.inner_channel import Handler, InnerChannel
from rossec.errors import ConfigurationError, KeyMessageRefused, KeyServiceRefused, PeerUserRefused
from rossec.net.host.peeruid import UnixPeer
from rossec.operation.reaping import reap
from rossec.ros.text import printable

CREDENTIALS: Final = "CREDENTIALS_DIRECTORY"  # of systemd: the passphrase may be there
MODULE: Final = "rossec.authority.keyservice.face"
START: Final = 30.0  # seconds until it listens
MAX_DELAY: Final = 60.0
_END: Final = 5.0  # seconds between the end of the connection and SIGKILL
_log = logging.getLogger("rossec.authority.service")


class FaceOptions(NamedTuple):
    """Where nodes join (`host:port`), the master's URI, and the log's form."""

    join_address: str
    master_uri: str
    log: str = "text"


class FaceProcess:
    """The face, from the first start to the end of the service.

    Args:
        home: of the authority.
        options: of the face.
        environ: its environment.
    """

    def __init__(
        self,
        home: AuthorityHome,
        options: FaceOptions,
        environ: Mapping[str, str],
        module: str = MODULE,
    ) -> None:
        self.port = 0
        self._command = [sys.executable, "-I", "-m", module]
        self._arguments = [str(home.node().path), *options]
        self._environ = {name: text for name, text in environ.items() if name != CREDENTIALS}
        self._process: subprocess.Popen[bytes] | None = None
        self._socket: socket.socket | None = None
        self._channel: InnerChannel | None = None
        self._started: asyncio.Future[int] | None = None

    def spawn(self) -> None:
        """Start the process; `run` connects to it."""
        ours, theirs = socket.socketpair()
        with theirs:
            self._process = subprocess.Popen(  # noqa: S603 - this program's own module
                [*self._command, str(theirs.fileno()), *self._arguments],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                pass_fds=(theirs.fileno(),),
                env=self._environ,
                start_new_session=True,  # Ctrl-C is for the service, which ends the face
            )
        self._socket = ours

    def admit(self, peer: UnixPeer) -> None:
        """Raise for the face itself, which may start no other process: it may not ask for keys.

        Raises:
            PeerUserRefused: it is the face.
        """
        if self._process is not None and peer.process == self._process.pid:
            raise PeerUserRefused("the network process may not use the service's socket")

    async def run(self, join: Handler, name: Handler | None = None) -> None:
        """Keep a face running until this is cancelled; `join` and `name` answer its requests."""
        delay = 0.5
        while True:
            begin = asyncio.get_running_loop().time()
            try:
                await self._run_once(join, name)
            except KeyMessageRefused as error:
                _log.error("the network process breaks the protocol: %s", error)
            finally:
                await self._end()
            lasted = asyncio.get_running_loop().time() - begin
            delay = 1.0 if lasted > MAX_DELAY else min(MAX_DELAY, 2 * delay)
            _log.error("the network process ended; it is started again in %.0f s", delay)
            await asyncio.sleep(delay)
            self.spawn()

    async def started(self) -> int:
        """Wait until the first face listens; returns its port.

        Raises:
            ConfigurationError: it cannot listen, or does not start.
        """
        try:
            async with asyncio.timeout(START):
                return await self._future()
        except TimeoutError as error:
            raise ConfigurationError(
                "the network process does not start", "its messages are in the log"
            ) from error

    async def call(self, method: str, arguments: list[Value], within: int) -> Value:
        """Have it call the master; returns the value of the answer.

        Raises:
            KeyServiceRefused: the master is out of reach or refuses, or the face is not there.
            TimeoutError: no answer.
        """
        if self._channel is None:
            raise KeyServiceRefused("the network process does not run", "it is started again")
        operation = inner_messages.CALL
        return await self._channel.call(operation, method, arguments, within, within=within + 1)

    async def _run_once(self, join: Handler, name: Handler | None) -> None:
        if self._socket is None:
            return
        handlers: dict[str, Handler] = {
            inner_messages.READY: self._ready,
            inner_messages.FAILED: self._failed,
            inner_messages.JOIN: join,
        }
        if name is not None:
            handlers[inner_messages.NAME] = name
        self._channel = InnerChannel(self._socket, handlers, inner_messages.MAX_FROM_FACE)
        self._socket = None
        try:
            await self._channel.run()
        finally:
            self._channel = None

    async def _end(self) -> None:
        """Reap it: it ends with the connection, or is killed. Until then `admit` refuses it."""
        process = self._process
        if process is None:
            return
        try:
            await reap(process, _END)
        finally:
            self._process = None

    def close(self) -> None:
        """End a face that was started and never connected."""
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
