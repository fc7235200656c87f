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


DoorT = TypeVar("DoorT", bound=PooledPort)


class PortPool(Generic[DoorT]):
    """Doors of one kind.

    Args:
        closing: called with the door that makes room, and the address it was for.
        can_spare: whether an idle door for this address may make room.
    """

    def __init__(
        self,
        closing: Callable[[Endpoint, DoorT], None],
        can_spare: Callable[[Endpoint], bool] = lambda _: True,
        limit: int = LIMIT,
    ) -> None:
        self._closing = closing
        self._can_spare = can_spare
        self._limit = limit
        self._doors: dict[Endpoint, DoorT] = {}  # the one asked for last comes last

    def get(self, place: Endpoint) -> DoorT | None:
        """The door for `place`, without asking for it."""
        return self._doors.get(place)

    def ask(self, place: Endpoint, make: Callable[[], DoorT]) -> DoorT:
        """The door for `place`, made if there is none.

        Raises:
            ConfigurationError: there are too many, and all are in use.
        """
        door = self._doors.pop(place, None)
        if door is None:
            if len(self._doors) >= self._limit:
                self._make_room()
            door = make()
        self._doors[place] = door
        return door

    def _make_room(self) -> None:
        for place, door in self._doors.items():
            if door.connections == 0 and self._can_spare(place):
                del self._doors[place]
                self._closing(place, door)
                return
        raise ConfigurationError(
            f"more than {self._limit} addresses in use in one sidecar",
            "give some of the nodes an identity of their own",
        )

    def __iter__(self) -> Iterator[DoorT]:
        return iter(tuple(self._doors.values()))
