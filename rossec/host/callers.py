"""Access control for programs of this host, at loopback ports and at their own listening ports.

The kernel's socket table gives the user at the other end. A private sidecar also requires that the
program it was started for, or a descendant of it, owns the socket: another program of the same
user is refused. Not kept out: root, and a program of the same user that attaches to one of these
(ptrace) or reads the identity's files.
"""

import asyncio
import os
import socket
import time
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path
from typing import Final, NamedTuple

from ca.bounded import Newest
from rossec.errors import PeerUserRefused
from rossec.host import local_sockets
from rossec.host.local_ports import LOOPBACK, Loopback
from rossec.host.local_sockets import Holder

PROC: Final = Path("/proc")
_MAX_STAT: Final = 4096  # usually some 300 bytes
_PARENT, _STARTED = 1, 19  # proc_pid_stat(5), counted from after the program's name

TIME_SLICE: Final = 0.002  # seconds
REMEMBERED: Final = 4096  # sockets

_ALL: Final = 1  # the process that all others descend from
_HINT: Final = "start it with `rossec run`; a program with capabilities needs `rossec sidecar`"


class Process(NamedTuple):
    """One process; `started` is in clock ticks since boot: a PID alone may be reused."""

    pid: int
    started: int


def parents() -> Iterator[tuple[int, int]]:
    for entry in os.listdir(PROC):  # noqa: PTH208 - names only, and many
        if entry.isdecimal():
            stat = _status(int(entry))
            if stat is not None:
                yield int(entry), stat[0]


def descendants(parents: Iterable[tuple[int, int]], ancestor: int) -> list[int]:
    children: dict[int, list[int]] = {}
    for pid, parent in parents:
        children.setdefault(parent, []).append(pid)
    found: list[int] = []
    pending = list(children.get(ancestor, ()))
    while pending:
        pid = pending.pop()
        found.append(pid)
        pending += children.get(pid, ())
    return found


def process(pid: int) -> Process | None:
    stat = _status(pid)
    return None if stat is None else Process(pid, stat[1])


def descends(pid: int, ancestor: int) -> bool:
    child_started: int | None = None
    while pid > 1:
        stat = _status(pid)
        if stat is None:
            return False
        parent, started = stat
        # No earlier than its parent: else this chain has a PID that was reused while it was read.
        if child_started is not None and started > child_started:
            return False
        if parent == ancestor:
            return True
        pid, child_started = parent, started
    return False


def _status(pid: int) -> tuple[int, int] | None:
    try:
        with open(f"{PROC}/{pid}/stat", "rb", buffering=0) as file:  # noqa: PTH123 - often
            stat = file.read(_MAX_STAT)
    except OSError:  # it has ended
        return None
    # The program name in parentheses may contain anything, also parentheses.
    fields = stat.rpartition(b")")[2].split()
    return int(fields[_PARENT]), int(fields[_STARTED])


def descriptors(pid: int) -> list[str]:
    try:
        return os.listdir(f"{PROC}/{pid}/fd")  # noqa: PTH208 - as above
    except OSError:  # it has ended or is not accessible
        return []


def socket_at(pid: int, descriptor: str) -> int | None:
    # The inode of the socket at a descriptor of a process; None: not a socket.
    try:
        target = os.readlink(f"{PROC}/{pid}/fd/{descriptor}")  # noqa: PTH115 - takes a str
    except OSError:
        return None
    return int(target[8:-1]) if target.startswith("socket:[") else None


class _SocketLocation(NamedTuple):
    process: Process
    descriptor: str


class SocketOwners:
    """Whether a descendant of a process holds a socket: found by a search, verified by its descriptor.

    A search reads the descriptors of every descendant, which grows with programs and connections. So
    callers that wait during a search share the next one, and a search yields to the loop.
    """

    def __init__(self, ancestor: int) -> None:
        self._ancestor = ancestor
        self._locations: Newest[int, _SocketLocation] = Newest(REMEMBERED)  # by socket inode
        self._seen: dict[Process, set[str]] = {}  # descriptors that were no caller's socket
        self._wanted: set[int] = set()
        self._search_lock = asyncio.Lock()

    async def holds(self, inode: int) -> bool:
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
        return self._locations[inode].process if await self.holds(inode) else None

    def _verified(self, inode: int) -> bool:
        location = self._locations.get(inode)
        if location is None:
            return False
        # A cached location is not trusted: it is read again each time, with the same process before and
        # after.
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
                self._locations[inode] = location
                # A program that connects again often uses the same descriptor.
                self._seen[location.process].discard(location.descriptor)
                if not missing:
                    return
            if time.monotonic() >= end:
                await asyncio.sleep(0)
                end = time.monotonic() + TIME_SLICE

    def _open_sockets(self) -> Iterator[tuple[int | None, _SocketLocation]]:
        found = [process(pid) for pid in descendants(parents(), self._ancestor)]
        self._seen = {each: self._seen.get(each, set()) for each in found if each is not None}
        later: list[_SocketLocation] = []
        for each, seen in self._seen.items():
            names = descriptors(each.pid)
            seen.intersection_update(names)
            for name in names:
                location = _SocketLocation(each, name)
                if name in seen:  # it was no caller's socket: read last
                    later.append(location)
                else:
                    seen.add(name)
                    yield socket_at(each.pid, name), location
        for location in later:
            yield socket_at(location.process.pid, location.descriptor), location


class Callers:
    """The allowed programs: of these users, and descendants of `ancestor` if there is one."""

    def __init__(
        self, users: Collection[int], ancestor: int | None = None, loopback: Loopback = LOOPBACK
    ) -> None:
        self.loopback: Final = loopback
        self._users = frozenset(users)
        self._owners = None if ancestor is None else SocketOwners(ancestor)
        self._processes = self._owners or SocketOwners(_ALL)

    async def check(self, sock: socket.socket) -> None:
        """Return if the program at the other end is allowed."""
        await self._check(local_sockets.holder_of(sock))

    async def check_listener(self, port: int) -> list[Holder]:
        """Return the sockets that listen at loopback port `port`, if their programs are allowed.

        After connecting, call `check_unchanged`: the program may have ended in between, and another
        one have bound its port.
        """
        holders = self.listeners(port)
        if not holders:
            raise ConnectionRefusedError(f"no program listens at port {port}")
        for holder in holders:
            await self._check(holder)
        return holders

    def check_unchanged(self, port: int, holders: list[Holder]) -> None:
        """Return if the same sockets still listen at `port`."""
        if self.listeners(port) != holders:
            raise ConnectionRefusedError(f"another program listens at port {port} now")

    def listeners(self, port: int) -> list[Holder]:
        return local_sockets.listeners((self.loopback.address, port))

    async def is_program_at(self, sock: socket.socket, port: int) -> bool:
        """Whether the process at the other end of `sock` listens at loopback port `port`."""
        caller = await self._processes.process_of(local_sockets.holder_of(sock).inode)
        holders = [await self._processes.process_of(each.inode) for each in self.listeners(port)]
        return caller is not None and caller in holders

    async def _check(self, holder: Holder) -> None:
        if holder.user not in self._users or not local_sockets.is_known(holder.user):
            raise PeerUserRefused(f"user {holder.user} may not use this sidecar", _HINT)
        if self._owners is not None and not await self._owners.holds(holder.inode):
            raise PeerUserRefused("this sidecar belongs to another program", _HINT)
