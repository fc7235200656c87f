"""Local ports: of loopback, for allowed programs or suspended; their numbers, their pools.

A suspended port is bound but does not listen: the kernel refuses callers as for a dead node, and no
other process gets the port (`rosnode ping` and `cleanup` rely on both). The address is 127.0.0.1 if
there is one. Stock ROS cannot parse [::1] in a URI, so ::1 is used by a host name that resolves to
it alone.
"""

import asyncio
import logging
import socket
from collections.abc import Awaitable, Callable, Hashable, Iterator
from contextlib import suppress
from typing import Final, Generic, NamedTuple, Protocol, TypeVar

from rossec.errors import ConfigurationError, PeerUserRefused
from rossec.host.runner import TaskSet

_BACKLOG: Final = 64
_ATTEMPTS: Final = 16
CONNECTIONS: Final = 256  # at a time and port; a program has one or two
LIMIT: Final = 512  # each way; a process has 1024 descriptors by default
PAUSE: Final = 1.0  # seconds, when this process is out of descriptors
_IPV6: Final = "::1"
_NAMES: Final = ("localhost", "ip6-localhost")  # those of Debian's /etc/hosts
_WITHOUT_IPV4: Final = (
    "this host has no 127.0.0.1: programs get the host name %s and ROS_IPV6=on; roscpp does not"
    " start without 127.0.0.1 (ip address add 127.0.0.1/8 dev lo)"
)
_HINT: Final = "give some of the nodes an identity of their own"
_log = logging.getLogger("rossec.sidecar")

Bound = TypeVar("Bound")
KeyT = TypeVar("KeyT", bound=Hashable)


class Loopback(NamedTuple):
    """The loopback address of programs and sidecar, and its host name in URIs."""

    address: str
    host: str


LOOPBACK: Final = Loopback("127.0.0.1", "127.0.0.1")


class PortAdmission(Protocol):
    """Where a port is, and who may connect: `Callers`, for programs of this host."""

    @property
    def loopback(self) -> Loopback: ...
    async def check(self, sock: socket.socket) -> None: ...


class LocalPort:
    """One port; suspended until `open`. `attend` serves an admitted connection and owns it."""

    def __init__(
        self, callers: PortAdmission, attend: Callable[[socket.socket], Awaitable[None]], port: int = 0
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
        return len(self._tasks)

    def open(self) -> None:
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
            with suppress(OSError):
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


def find_loopback() -> Loopback:
    """The loopback address of this host."""
    if is_here(LOOPBACK.address):
        return LOOPBACK
    if not is_here(_IPV6):
        raise ConfigurationError("this host has no loopback address", "ip link set lo up")
    for name in _NAMES:
        if _addresses(name) == {_IPV6}:
            _log.warning(_WITHOUT_IPV4, name)
            return Loopback(_IPV6, name)
    raise ConfigurationError(
        f"this host has no {LOOPBACK.address}, and no name for {_IPV6} that programs could use",
        f"write in /etc/hosts: {_IPV6} {' '.join(_NAMES)}",
    )


def is_here(address: str) -> bool:
    """Whether this host has the address."""
    try:
        with socket.socket(_family(address)) as sock:
            sock.bind((address, 0))
    except OSError:
        return False
    return True


def _addresses(name: str) -> set[str]:
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
    for _ in range(_ATTEMPTS - 1):
        with suppress(OSError):
            return bind(free_port())
    return bind(free_port())


def free_port() -> int:
    with socket.socket() as sock:
        sock.bind(("0.0.0.0", 0))  # noqa: S104 - it never listens
        found: int = sock.getsockname()[1]
        return found


class PooledPort(Protocol):
    @property
    def connections(self) -> int: ...


PortT = TypeVar("PortT", bound=PooledPort)


class PortPool(Generic[KeyT, PortT]):
    """A bounded pool with one port for each endpoint, or what else names where a port leads.

    An endpoint requested again gets the same port. When the pool is full, the least recently requested
    port without connections that `may_evict` names is closed. On the network that is only the port of a
    dead program: peers keep the address of a live one for any time. On loopback it is any port: programs
    look the port up before they connect.
    """

    def __init__(
        self,
        on_evict: Callable[[KeyT, PortT], None],
        may_evict: Callable[[KeyT], bool] = lambda _: True,
        limit: int = LIMIT,
        hint: str = _HINT,
    ) -> None:
        self._on_evict = on_evict
        self._may_evict = may_evict
        self._limit = limit
        self._hint = hint
        self._ports: dict[KeyT, PortT] = {}  # the most recently requested last

    def get(self, endpoint: KeyT) -> PortT | None:
        """The port for `endpoint`, if there is one; does not count as a request."""
        return self._ports.get(endpoint)

    def get_or_open(self, endpoint: KeyT, open_port: Callable[[], PortT]) -> PortT:
        """The port for `endpoint`, opened if there is none."""
        port = self._ports.pop(endpoint, None)
        if port is None:
            if len(self._ports) >= self._limit:
                for each, idle in self._ports.items():
                    if idle.connections == 0 and self._may_evict(each):
                        del self._ports[each]
                        self._on_evict(each, idle)
                        break
                else:
                    why = f"more than {self._limit} addresses in use in one process"
                    raise ConfigurationError(why, self._hint)
            port = open_port()
        self._ports[endpoint] = port
        return port

    def keys(self) -> tuple[KeyT, ...]:
        return tuple(self._ports)

    def remove(self, endpoint: KeyT) -> PortT | None:
        return self._ports.pop(endpoint, None)

    def __iter__(self) -> Iterator[PortT]:
        return iter(tuple(self._ports.values()))
