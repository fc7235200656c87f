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

_TIME_SLICE: Final = 0.002  # seconds
_REMEMBERED: Final = 4096  # sockets


class _SocketLocation(NamedTuple):
    """Where a socket was seen."""

    process: Process
    descriptor: str


class SocketOwners:
    """Finds holders among the descendants of `ancestor`."""

    def __init__(self, ancestor: int) -> None:
        self._ancestor = ancestor
        self._locations: dict[int, _SocketLocation] = {}  # by the socket's inode; the oldest first
        self._seen: dict[Process, set[str]] = {}  # descriptors that no caller's socket was at
        self._wanted: set[int] = set()
        self._search_lock = asyncio.Lock()

    async def holds(self, inode: int) -> bool:
        """Whether a descendant has the socket now."""
        if self._verified(inode):
            return True
        self._wanted.add(inode)
        async with self._search_lock:
            if inode in self._wanted:
                wanted = frozenset(self._wanted)  # those of a caller that gave up, too
                await self._search(wanted)
                self._wanted -= wanted
        return self._verified(inode)

    def _verified(self, inode: int) -> bool:
        location = self._locations.get(inode)
        if location is None:
            return False
        number = location.process.number
        is_held = (
            process(number) == location.process
            and socket_at(number, location.descriptor) == inode
            and descends(number, self._ancestor)
            and process(number) == location.process
        )
        if not is_held:
            del self._locations[inode]
        return is_held

    async def _search(self, wanted: frozenset[int]) -> None:
        missing = set(wanted)
        end = time.monotonic() + _TIME_SLICE
        for inode, location in self._open_sockets():
            if inode in missing:
                missing.discard(inode)
                self._remember(inode, location)
                if not missing:
                    return
            if time.monotonic() >= end:
                await asyncio.sleep(0)
                end = time.monotonic() + _TIME_SLICE

    def _remember(self, inode: int, location: _SocketLocation) -> None:
        self._locations[inode] = location
        # A program that calls again often does so at the same descriptor.
        self._seen[location.process].discard(location.descriptor)
        if len(self._locations) > _REMEMBERED:
            del self._locations[next(iter(self._locations))]

    def _open_sockets(self) -> Iterator[tuple[int | None, _SocketLocation]]:
        """What the descendants have open, the likeliest first."""
        found = [process(number) for number in descendants(parents(), self._ancestor)]
        self._seen = {each: self._seen.get(each, set()) for each in found if each is not None}
        later: list[_SocketLocation] = []
        for each, seen in self._seen.items():
            names = descriptors(each.number)
            seen.intersection_update(names)
            for name in names:
                location = _SocketLocation(each, name)
                if name in seen:
                    later.append(location)
                else:
                    seen.add(name)
                    yield socket_at(each.number, name), location
        for location in later:
            yield socket_at(location.process.number, location.descriptor), location
