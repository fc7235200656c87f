"""A bounded pool with one port for each endpoint, or what else names where a port leads.

An endpoint requested again gets the same port. When the pool is full, the least recently requested
port without connections that may be evicted is closed. On the network that is only the port of a
dead program: peers keep the address of a live one for any time. On loopback it is any port:
programs look the port up before they connect.
"""

from collections.abc import Callable, Hashable, Iterator
from typing import Final, Generic, Protocol, TypeVar

from rossec.errors import ConfigurationError

LIMIT: Final = 512  # each way; a process has 1024 descriptors by default


class PooledPort(Protocol):
    """What the pool needs of a port."""

    @property
    def connections(self) -> int:
        """The number of open connections."""


KeyT = TypeVar("KeyT", bound=Hashable)
PortT = TypeVar("PortT", bound=PooledPort)
_HINT: Final = "give some of the nodes an identity of their own"


class PortPool(Generic[KeyT, PortT]):
    """Ports of one kind.

    Args:
        on_evict: called with the endpoint and its evicted port.
        may_evict: whether the idle port for this endpoint may be evicted.
        hint: what to do when the pool is full of ports in use.
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
        """The port for `endpoint`, opened if there is none.

        Raises:
            ConfigurationError: the pool is full, and no port may be evicted.
        """
        port = self._ports.pop(endpoint, None)
        if port is None:
            if len(self._ports) >= self._limit:
                self._evict()
            port = open_port()
        self._ports[endpoint] = port
        return port

    def keys(self) -> tuple[KeyT, ...]:
        """Where the ports lead; the most recently requested last."""
        return tuple(self._ports)

    def remove(self, endpoint: KeyT) -> PortT | None:
        """Take the port for `endpoint` out of the pool, if there is one; it stays open."""
        return self._ports.pop(endpoint, None)

    def _evict(self) -> None:
        for endpoint, port in self._ports.items():
            if port.connections == 0 and self._may_evict(endpoint):
                del self._ports[endpoint]
                self._on_evict(endpoint, port)
                return
        raise ConfigurationError(
            f"more than {self._limit} addresses in use in one process", self._hint
        )

    def __iter__(self) -> Iterator[PortT]:
        return iter(tuple(self._ports.values()))
