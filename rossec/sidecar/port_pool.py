"""What is open for each address, and never more than so much of it.

An address that is asked for again gets the same door. When there are too many, the one that was
asked for longest ago, serves nobody and can be spared makes room. Towards the network that is the
door of a dead program alone: peers keep the address of a live one, however long they stay away. On
loopback it is any: programs ask before they connect.
"""

from collections.abc import Callable, Iterator
from typing import Final, Generic, Protocol, TypeVar

from rossec.errors import ConfigurationError
from rossec.sidecar.core.endpoints import Endpoint

LIMIT: Final = 512  # each way; a process has 1024 descriptors unless told otherwise


class PooledPort(Protocol):
    """What is asked of a door here."""

    @property
    def connections(self) -> int:
        """How many it serves."""


PortT = TypeVar("PortT", bound=PooledPort)


class PortPool(Generic[PortT]):
    """Doors of one kind.

    Args:
        closing: called with the door that makes room, and the address it was for.
        can_spare: whether an idle door for this address may make room.
    """

    def __init__(
        self,
        on_evict: Callable[[Endpoint, PortT], None],
        may_evict: Callable[[Endpoint], bool] = lambda _: True,
        limit: int = LIMIT,
    ) -> None:
        self._on_evict = on_evict
        self._may_evict = may_evict
        self._limit = limit
        self._ports: dict[Endpoint, PortT] = {}  # the one asked for last comes last

    def get(self, endpoint: Endpoint) -> PortT | None:
        """The door for `place`, without asking for it."""
        return self._ports.get(endpoint)

    def get_or_open(self, endpoint: Endpoint, open_port: Callable[[], PortT]) -> PortT:
        """The door for `place`, made if there is none.

        Raises:
            ConfigurationError: there are too many, and all are in use.
        """
        port = self._ports.pop(endpoint, None)
        if port is None:
            if len(self._ports) >= self._limit:
                self._evict()
            port = open_port()
        self._ports[endpoint] = port
        return port

    def _evict(self) -> None:
        for endpoint, port in self._ports.items():
            if port.connections == 0 and self._may_evict(endpoint):
                del self._ports[endpoint]
                self._on_evict(endpoint, port)
                return
        raise ConfigurationError(
            f"more than {self._limit} addresses in use in one sidecar",
            "give some of the nodes an identity of their own",
        )

    def __iter__(self) -> Iterator[PortT]:
        return iter(tuple(self._ports.values()))
