"""Whether a descendant of a process holds a socket: found by a search, verified by its descriptor.

A search reads the descriptors of every descendant, which grows with programs and connections. So
callers that wait during a search share the next one; descriptors seen before are read last; and a
search yields to the loop every few milliseconds. A cached location is not trusted: each time it is
read again that the process, the same before and after, is a descendant and has the socket.
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

TIME_SLICE: Final = 0.002  # seconds
REMEMBERED: Final = 4096  # sockets


class _SocketLocation(NamedTuple):
    """The process and descriptor at which a socket was seen."""

    process: Process
    descriptor: str


class SocketOwners:
    """Finds the holders of sockets among the descendants of `ancestor`."""

    def __init__(self, ancestor: int) -> None:
        self._ancestor = ancestor
        self._locations: dict[int, _SocketLocation] = {}  # by socket inode; the oldest first
        self._seen: dict[Process, set[str]] = {}  # descriptors that were no caller's socket
        self._wanted: set[int] = set()
        self._search_lock = asyncio.Lock()

    async def holds(self, inode: int) -> bool:
        """Whether a descendant holds the socket now."""
        if self._verified(inode):
            return True
        self._wanted.add(inode)
        async with self._search_lock:
            if inode in self._wanted:
                wanted = frozenset(self._wanted)  # also those of cancelled callers
                await self._search(wanted)
                self._wanted -= wanted
        return self._verified(inode)

    async def process_of(self, inode: int) -> Process | None:
        """The descendant that holds the socket now; None: none does."""
        return self._locations[inode].process if await self.holds(inode) else None

    def _verified(self, inode: int) -> bool:
        location = self._locations.get(inode)
        if location is None:
            return False
        pid = location.process.pid
        is_held = (
            process(pid) == location.process
            and socket_at(pid, location.descriptor) == inode
            and descends(pid, self._ancestor)
            and process(pid) == location.process
        )
        if not is_held:
            del self._locations[inode]
        return is_held

    async def _search(self, wanted: frozenset[int]) -> None:
        missing = set(wanted)
        end = time.monotonic() + TIME_SLICE
        for inode, location in self._open_sockets():
            if inode in missing:
                missing.discard(inode)
                self._remember(inode, location)
                if not missing:
                    return
            if time.monotonic() >= end:
                await asyncio.sleep(0)
                end = time.monotonic() + TIME_SLICE

    def _remember(self, inode: int, location: _SocketLocation) -> None:
        self._locations[inode] = location
        # A program that connects again often uses the same descriptor.
        self._seen[location.process].discard(location.descriptor)
        if len(self._locations) > REMEMBERED:
            del self._locations[next(iter(self._locations))]

    def _open_sockets(self) -> Iterator[tuple[int | None, _SocketLocation]]:
        """The open descriptors of the descendants, the most likely first."""
        found = [process(pid) for pid in descendants(parents(), self._ancestor)]
        self._seen = {each: self._seen.get(each, set()) for each in found if each is not None}
        later: list[_SocketLocation] = []
        for each, seen in self._seen.items():
            names = descriptors(each.pid)
            seen.intersection_update(names)
            for name in names:
                location = _SocketLocation(each, name)
                if name in seen:
                    later.append(location)
                else:
                    seen.add(name)
                    yield socket_at(each.pid, name), location
        for location in later:
            yield socket_at(location.process.pid, location.descriptor), location
