"""A loopback port that keeps its number: open to allowed programs, or suspended.

A suspended port is bound but does not listen: the kernel refuses callers as for a dead node, and no
other process gets the port (`rosnode ping` and `cleanup` rely on both). The address is 127.0.0.1 if
there is one. Stock ROS cannot parse [::1] in a URI, so ::1 is used by a host name that resolves to
it alone.
"""

import asyncio
import contextlib
import logging
import socket
from collections.abc import Awaitable, Callable
from functools import partial
from typing import Final, Protocol, TypeVar

from rossec.errors import ConfigurationError, PeerUserRefused
from rossec.net.aio.tasks import TaskSet
from rossec.sidecar.core.endpoints import LOOPBACK, Loopback
from rossec.sidecar.plain_stream import PlainStream

_BACKLOG: Final = 64
_ATTEMPTS: Final = 16
CONNECTIONS: Final = 256  # at a time and port; a program has one or two
_IPV6: Final = "::1"
_NAMES: Final = ("localhost", "ip6-localhost")  # those of Debian's /etc/hosts
_WITHOUT_IPV4: Final = (
    "this host has no 127.0.0.1: programs get the host name %s and ROS_IPV6=on; roscpp does not"
    " start without 127.0.0.1 (ip address add 127.0.0.1/8 dev lo)"
)
PAUSE: Final = 1.0  # seconds, when this process is out of descriptors

_log = logging.getLogger("rossec.sidecar")
Handler = Callable[[PlainStream], Awaitable[None]]
Bound = TypeVar("Bound")


class Admission(Protocol):
    """Where a port is, and who may connect: `Callers`, for programs of this host."""

    @property
    def loopback(self) -> Loopback:
        """The address of the port."""

    async def check(self, sock: socket.socket) -> None:
        """Return if the program at the other end may connect.

        Raises:
            PeerUserRefused: it may not.
        """


class LocalPort:
    """One port; suspended until `open`. `attend` serves an admitted connection and owns it."""

    def __init__(
        self,
        callers: Admission,
        attend: Callable[[socket.socket], Awaitable[None]],
        port: int = 0,
    ) -> None:
        self._callers = callers
        self._attend = attend
        self._socket = bind_loopback(port, callers.loopback)
        self._loop = asyncio.get_running_loop()
        self._tasks = TaskSet()
        self._accepted: set[socket.socket] = set()  # whose task has not begun
        self._is_open = False
        self.port: Final[int] = self._socket.getsockname()[1]

    @property
    def connections(self) -> int:
        """The number of open connections."""
        return len(self._tasks)

    def open(self) -> None:
        """Listen."""
        if not self._is_open:
            self._is_open = True
            # Open connections may still use the port; a suspended port must not be bound by others.
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._socket.listen(_BACKLOG)
            self._start_accepting()

    def suspend(self) -> None:
        """Refuse callers, keep the number; open connections continue."""
        if self._is_open:
            self._is_open = False
            self._loop.remove_reader(self._socket.fileno())
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 0)
            with contextlib.suppress(OSError):
                self._socket.shutdown(socket.SHUT_RDWR)

    async def close(self) -> None:
        """Release the port and close its connections."""
        self.suspend()
        self._socket.close()
        await self._tasks.close()
        for sock in self._accepted:  # a task that is cancelled before it begins closes nothing
            sock.close()
        self._accepted.clear()

    def _start_accepting(self) -> None:
        if self._is_open:
            self._loop.add_reader(self._socket.fileno(), self._accept)

    def _accept(self) -> None:
        try:
            sock, _ = self._socket.accept()
        except (BlockingIOError, InterruptedError, ConnectionAbortedError):  # the caller is gone
            return
        except OSError as error:  # out of descriptors: the socket would stay readable
            _log.warning("cannot accept programs for %s s: %s", PAUSE, error)
            self._loop.remove_reader(self._socket.fileno())
            self._loop.call_later(PAUSE, self._start_accepting)
            return
        if len(self._tasks) >= CONNECTIONS:
            _log.warning("too many connections at port %d", self.port)
            sock.close()
            return
        self._accepted.add(sock)
        self._tasks.spawn(self._serve(sock), f"loopback port {self.port}")

    async def _serve(self, sock: socket.socket) -> None:
        self._accepted.discard(sock)
        try:
            await self._callers.check(sock)
        except (PeerUserRefused, OSError) as error:
            hint = error.hint if isinstance(error, PeerUserRefused) else "its owner is unknown"
            _log.warning("refused a program at port %d: %s (%s)", self.port, error, hint)
            sock.close()
            return
        except BaseException:
            sock.close()
            raise
        await self._attend(sock)


class LoopbackPort(LocalPort):
    """A port whose handler gets a stream; it is closed when the handler returns."""

    def __init__(self, callers: Admission, handler: Handler, port: int = 0) -> None:
        super().__init__(callers, partial(_attend_stream, handler), port)


async def _attend_stream(handler: Handler, sock: socket.socket) -> None:
    stream = PlainStream(sock)
    try:
        await handler(stream)
    finally:
        stream.abort()


def find_loopback() -> Loopback:
    """The loopback address of this host.

    Raises:
        ConfigurationError: there is none, or no name for it.
    """
    if _is_here(LOOPBACK.address):
        return LOOPBACK
    if not _is_here(_IPV6):
        raise ConfigurationError("this host has no loopback address", "ip link set lo up")
    for name in _NAMES:
        if _addresses(name) == {_IPV6}:
            _log.warning(_WITHOUT_IPV4, name)
            return Loopback(_IPV6, name)
    raise ConfigurationError(
        f"this host has no {LOOPBACK.address}, and no name for {_IPV6} that programs could use",
        f"write in /etc/hosts: {_IPV6} {' '.join(_NAMES)}",
    )


def _is_here(address: str) -> bool:
    try:
        with socket.socket(_family(address)) as sock:
            sock.bind((address, 0))
    except OSError:
        return False
    return True


def _addresses(name: str) -> set[str]:
    """The addresses of `name` for a program that prefers IPv6."""
    try:
        found = socket.getaddrinfo(name, None, socket.AF_INET6, socket.SOCK_STREAM)
    except OSError:
        return set()
    return {str(where[0]) for *_, where in found}


def _family(address: str) -> int:
    return socket.AF_INET6 if ":" in address else socket.AF_INET


def bind_loopback(port: int = 0, loopback: Loopback = LOOPBACK) -> socket.socket:
    """A socket bound to `port` of loopback, by default any free one.

    The port is bound explicitly: only then does Linux reserve it while the socket does not listen.

    Raises:
        OSError: the port is taken.
    """
    if port:
        return _bind(loopback.address, port, reuse=True)
    return bind_free_port(lambda port: _bind(loopback.address, port))


def _bind(address: str, port: int, *, reuse: bool = False) -> socket.socket:
    sock = socket.socket(_family(address))
    # A fixed port may be in TIME_WAIT; it is never suspended.
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, int(reuse))
    sock.setblocking(False)
    try:
        sock.bind((address, port))
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 0)
    except BaseException:
        sock.close()
        raise
    return sock


def bind_free_port(bind: Callable[[int], Bound]) -> Bound:
    """The result of `bind` for a free port; tried again if another process took the port."""
    for _ in range(_ATTEMPTS - 1):
        with contextlib.suppress(OSError):
            return bind(free_port())
    return bind(free_port())


def free_port() -> int:
    """A port that was just free at every IPv4 address: there may be no 127.0.0.1."""
    with socket.socket() as sock:
        sock.bind(("0.0.0.0", 0))  # noqa: S104 - it never listens
        found: int = sock.getsockname()[1]
        return found
