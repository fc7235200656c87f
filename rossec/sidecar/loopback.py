"""A loopback port that keeps its number: open to the programs that may use it, or at rest.

At rest it is bound and does not listen, so the kernel refuses callers as it does for a dead node,
and nobody else gets the port (`rosnode ping` and `cleanup` rely on both).
"""

import asyncio
import contextlib
import logging
import socket
from collections.abc import Awaitable, Callable
from typing import Final, TypeVar

from rossec.errors import PeerUserRefused
from rossec.net.tasks import TaskSet
from rossec.sidecar.addresses import LOOPBACK
from rossec.sidecar.callers import Callers
from rossec.sidecar.plain import PlainStream

_BACKLOG: Final = 64
_ATTEMPTS: Final = 16
_CONNECTIONS: Final = 256  # at a time and port; a program has one or two
_REST: Final = 1.0  # seconds, when this process is out of descriptors

_log = logging.getLogger("rossec.sidecar")
Handler = Callable[[PlainStream], Awaitable[None]]
Bound = TypeVar("Bound")


class LoopbackPort:
    """One port; it rests until `open`."""

    def __init__(self, callers: Callers, handler: Handler, port: int = 0) -> None:
        self._callers = callers
        self._handler = handler
        self._socket = reserve(port)
        self._loop = asyncio.get_running_loop()
        self._tasks = TaskSet()
        self._is_open = False
        self.port: Final[int] = self._socket.getsockname()[1]

    @property
    def connections(self) -> int:
        """How many are being served."""
        return len(self._tasks)

    def open(self) -> None:
        """Listen."""
        if not self._is_open:
            self._is_open = True
            # Connections from before may still use the number; at rest nobody else may bind it.
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._socket.listen(_BACKLOG)
            self._watch()

    def rest(self) -> None:
        """Refuse callers, keep the number; connections that are served go on."""
        if self._is_open:
            self._is_open = False
            self._loop.remove_reader(self._socket.fileno())
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 0)
            with contextlib.suppress(OSError):
                self._socket.shutdown(socket.SHUT_RDWR)

    async def close(self) -> None:
        """Give the port back and end what is served."""
        self.rest()
        self._socket.close()
        await self._tasks.close()

    def _watch(self) -> None:
        if self._is_open:
            self._loop.add_reader(self._socket.fileno(), self._accept)

    def _accept(self) -> None:
        try:
            sock, _ = self._socket.accept()
        except (BlockingIOError, InterruptedError, ConnectionAbortedError):  # gone meanwhile
            return
        except OSError as error:  # out of descriptors: who waits would be told of again at once
            _log.warning("cannot accept programs for %s s: %s", _REST, error)
            self._loop.remove_reader(self._socket.fileno())
            self._loop.call_later(_REST, self._watch)
            return
        if len(self._tasks) >= _CONNECTIONS:
            _log.warning("too many connections at loopback port %d", self.port)
            sock.close()
            return
        self._tasks.spawn(self._serve(sock), f"loopback port {self.port}")

    async def _serve(self, sock: socket.socket) -> None:
        try:
            await self._callers.check(sock)
        except (PeerUserRefused, OSError) as error:
            hint = error.hint if isinstance(error, PeerUserRefused) else "nobody knows whose it is"
            _log.warning("refused a program at port %d: %s (%s)", self.port, error, hint)
            sock.close()
            return
        except BaseException:
            sock.close()
            raise
        stream = PlainStream(sock)
        try:
            await self._handler(stream)
        finally:
            stream.abort()


def reserve(port: int = 0) -> socket.socket:
    """A socket bound to `port` of loopback, by default any free one.

    The number is named in the call to bind: only then does Linux keep it while the socket rests.

    Raises:
        OSError: the port is taken.
    """
    return _bound(port, again=True) if port else on_free_port(_bound)


def _bound(port: int, *, again: bool = False) -> socket.socket:
    sock = socket.socket()
    # A service's own port may be in TIME_WAIT from before; it never rests.
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, int(again))
    sock.setblocking(False)
    try:
        sock.bind((LOOPBACK, port))
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 0)
    except BaseException:
        sock.close()
        raise
    return sock


def on_free_port(bind: Callable[[int], Bound]) -> Bound:
    """What `bind` makes of a free port; where another process was faster, of the next one."""
    for _ in range(_ATTEMPTS - 1):
        with contextlib.suppress(OSError):
            return bind(free_port())
    return bind(free_port())


def free_port() -> int:
    """A port that was free a moment ago."""
    with socket.socket() as sock:
        sock.bind((LOOPBACK, 0))
        found: int = sock.getsockname()[1]
        return found
