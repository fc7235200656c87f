"""Which descendant of a process holds a socket: found by a search, proved by one descriptor.

A search reads what every descendant has open, which grows with programs and their connections. So
those who wait while one runs share the next; what a process had open before is looked at last; and
whose turn it is not waits for milliseconds at most. Nothing that is remembered is believed: that a
process, the same before and after, is below the ancestor and has the socket is read each time.
"""

import asyncio
import time
from collections.abc import Iterator
from typing import Final, NamedTuple

from rossec.sidecar.processes import (
    Process,
    descendants,
    descends,
    descriptors,
    parents,
    process,
    socket_at,
)

_TURN: Final = 0.002  # seconds
_REMEMBERED: Final = 4096  # sockets


class _SocketPlace(NamedTuple):
    """Where a socket was seen."""

    process: Process
    descriptor: str


class SocketOwners:
    """Finds holders among the descendants of `ancestor`."""

    def __init__(self, ancestor: int) -> None:
        self._ancestor = ancestor
        self._places: dict[int, _SocketPlace] = {}  # by the socket's inode; the oldest first
        self._seen: dict[Process, set[str]] = {}  # descriptors that no caller's socket was at
        self._wanted: set[int] = set()
        self._searching = asyncio.Lock()

    async def have(self, inode: int) -> bool:
        """Whether a descendant has the socket now."""
        if self._proved(inode):
            return True
        self._wanted.add(inode)
        async with self._searching:
            if inode in self._wanted:
                wanted = frozenset(self._wanted)  # those of a caller that gave up, too
                await self._search(wanted)
                self._wanted -= wanted
        return self._proved(inode)

    def _proved(self, inode: int) -> bool:
        place = self._places.get(inode)
        if place is None:
            return False
        number = place.process.number
        holds = (
            process(number) == place.process
            and socket_at(number, place.descriptor) == inode
            and descends(number, self._ancestor)
            and process(number) == place.process
        )
        if not holds:
            del self._places[inode]
        return holds

    async def _search(self, wanted: frozenset[int]) -> None:
        missing = set(wanted)
        end = time.monotonic() + _TURN
        for inode, place in self._sightings():
            if inode in missing:
                missing.discard(inode)
                self._remember(inode, place)
                if not missing:
                    return
            if time.monotonic() >= end:
                await asyncio.sleep(0)
                end = time.monotonic() + _TURN

    def _remember(self, inode: int, place: _SocketPlace) -> None:
        self._places[inode] = place
        # A program that calls again often does so at the same descriptor.
        self._seen[place.process].discard(place.descriptor)
        if len(self._places) > _REMEMBERED:
            del self._places[next(iter(self._places))]

    def _sightings(self) -> Iterator[tuple[int | None, _SocketPlace]]:
        """What the descendants have open, the likeliest first."""
        found = [process(number) for number in descendants(parents(), self._ancestor)]
        self._seen = {each: self._seen.get(each, set()) for each in found if each is not None}
        later: list[_SocketPlace] = []
        for each, seen in self._seen.items():
            names = descriptors(each.number)
            seen.intersection_update(names)
            for name in names:
                place = _SocketPlace(each, name)
                if name in seen:
                    later.append(place)
                else:
                    seen.add(name)
                    yield socket_at(each.number, name), place
        for place in later:
            yield socket_at(place.process.number, place.descriptor), place
