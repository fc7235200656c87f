"""The doors of a relay as its masters want them: one door for a target, whoever wants it.

A shell between `master_link`, which says what a master wants, and `doors`, the ports themselves.
"""

from collections.abc import Callable, Mapping
from typing import Final

from rossec.errors import RelayRefused
from rossec.master.state.doors import Door, Target, Way
from rossec.overlay import doors, mux_units
from rossec.overlay.doors import Carry, Doors
from rossec.sidecar.loopback_port import Admission


class DoorTable:
    """Which masters want a door.

    Args:
        admission, carry: as of `Doors`.
        ways: how each peer is reached, by its label; what is not there is no peer.
    """

    def __init__(
        self,
        admission: Admission,
        carry: Carry,
        ways: Callable[[], Mapping[str, Way]],
        limit: int = doors.LIMIT,
    ) -> None:
        self.ways: Final = ways
        self._ports = Doors(admission, carry, self._given_up, limit)
        self._wanted: dict[Target, set[str]] = {}
        self._dropped: dict[str, set[Target]] = {}  # by master

    def __len__(self) -> int:
        return len(self._wanted)

    async def open(self, target: Target, master: str) -> Door:
        """The door of `target`, opened if there is none, and held for `master`.

        Raises:
            RelayRefused: there is no such peer.
            ConfigurationError, OSError: no port is free.
        """
        if target.peer not in self.ways():
            raise RelayRefused(
                f"no relay is called {target.peer} here", f"rossec relay add {target.peer} FILE"
            )
        host, port = self._ports.open(_door(target))
        self._wanted.setdefault(target, set()).add(master)
        return Door(host, port)

    def release(self, target: Target, master: str) -> None:
        """`master` wants it no longer: nobody new is let in when no master does."""
        masters = self._wanted.get(target, set())
        masters.discard(master)
        if not masters and self._wanted.pop(target, None) is not None:
            self._ports.close(_door(target))

    def take_dropped(self, master: str) -> set[Target]:
        """What `master` wants and `drop_peer` has closed since the last call.

        The peer may be back with another card, and masters know the old doors.
        """
        return self._dropped.pop(master, set())

    async def close(self) -> None:
        """Close every door and every connection."""
        await self._ports.close_all()

    def drop_peer(self, peer: str) -> None:
        """Close every door to a peer that is gone."""
        for target in [each for each in self._wanted if each.peer == peer]:
            for master in self._wanted.pop(target):
                self._dropped.setdefault(master, set()).add(target)
        self._ports.close_peer(peer)

    def _given_up(self, door: doors.Door) -> None:
        """It had to make room for another one."""
        self._wanted.pop(Target(door.peer, *door.target), None)


def _door(target: Target) -> doors.Door:
    return doors.Door(target.peer, mux_units.Target(target.kind, target.name))
