"""Which programs of this host may use the sidecar's loopback ports, and be reached by it.

The kernel's socket table tells the user at the other end. A private sidecar also wants the socket
to be held by the program it was started for, or a descendant of it: another program of the same
user is refused. What this cannot keep out: root, and a program of the same user that attaches to
one of these (ptrace) or reads the identity's files.
"""

import asyncio
import os
import socket
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Final

from rossec.errors import PeerUserRefused
from rossec.net import peeruid
from rossec.net.peeruid import Holder
from rossec.sidecar.addresses import LOOPBACK

_PROC: Final = Path("/proc")
_RECENT: Final = 8  # processes that called before, looked at first
_HINT: Final = "start it with `rossec run`; one with capabilities needs `rossec sidecar`"


class Callers:
    """Who may call.

    Args:
        users: their user ids.
        ancestor: the process whose descendants may; None: any process of these users.
    """

    def __init__(self, users: Collection[int], ancestor: int | None = None) -> None:
        self._users = frozenset(users)
        self._ancestor = ancestor
        self._recent: list[int] = []

    async def check(self, sock: socket.socket) -> None:
        """Return if a program that may is at the other end.

        Raises:
            PeerUserRefused: it may not, or nobody knows who it is.
        """
        await self._check(peeruid.holder_of(sock))

    async def check_listener(self, port: int) -> list[Holder]:
        """Return who listens at the loopback port `port`, if that is a program that may.

        Whoever connects then asks `check_unchanged`: the program may end in between, and anybody
        take its port.

        Raises:
            PeerUserRefused: one of those who listen there may not be reached.
            ConnectionRefusedError: nobody does.
        """
        holders = peeruid.listeners((LOOPBACK, port))
        if not holders:
            raise ConnectionRefusedError(f"nobody listens at port {port}")
        for holder in holders:
            await self._check(holder)
        return holders

    def check_unchanged(self, port: int, holders: list[Holder]) -> None:
        """Return if those who were found to listen at `port` still do.

        Raises:
            ConnectionRefusedError: it has changed hands.
        """
        if peeruid.listeners((LOOPBACK, port)) != holders:
            raise ConnectionRefusedError(f"port {port} has changed hands")

    async def _check(self, holder: Holder) -> None:
        if holder.user not in self._users or not peeruid.is_known(holder.user):
            raise PeerUserRefused(f"user {holder.user} may not use this sidecar", _HINT)
        ancestor = self._ancestor
        if ancestor is None or self._is_recent(holder.inode, ancestor):
            return
        # Every process of the host is looked at: not in the loop.
        process = await asyncio.to_thread(_searched, holder.inode, ancestor)
        if process is None:
            raise PeerUserRefused("this sidecar belongs to another program", _HINT)
        self._recent = [process, *(each for each in self._recent if each != process)][:_RECENT]

    def _is_recent(self, inode: int, ancestor: int) -> bool:
        """Whether a program that called before holds the socket, and still descends from ours."""
        return any(
            descends(process, ancestor) and held_by(inode, (process,)) for process in self._recent
        )


def _searched(inode: int, ancestor: int) -> int | None:
    for process in descendants(parents(), ancestor):
        if held_by(inode, (process,)):
            return process
    return None


def descends(process: int, ancestor: int) -> bool:
    """Whether `process` is alive and below `ancestor`."""
    while process > 1:
        found = _parent(process)
        if found is None or found == ancestor:
            return found is not None
        process = found
    return False


def descendants(parents: Iterable[tuple[int, int]], ancestor: int) -> list[int]:
    """The processes below `ancestor`, from pairs of process and parent. Pure."""
    children: dict[int, list[int]] = {}
    for process, parent in parents:
        children.setdefault(parent, []).append(process)
    found: list[int] = []
    waiting = list(children.get(ancestor, ()))
    while waiting:
        process = waiting.pop()
        found.append(process)
        waiting += children.get(process, ())
    return found


def parents() -> Iterable[tuple[int, int]]:
    """Each process of this host with its parent."""
    for entry in os.listdir(_PROC):  # noqa: PTH208 - names alone, and there are many
        if entry.isdecimal():
            parent = _parent(int(entry))
            if parent is not None:
                yield int(entry), parent


def _parent(process: int) -> int | None:
    try:
        stat = (_PROC / str(process) / "stat").read_bytes()
    except OSError:  # gone meanwhile
        return None
    # The program's name, in parentheses, may hold anything; after the last one it is plain.
    return int(stat.rpartition(b")")[2].split()[1])


def held_by(inode: int, processes: Iterable[int]) -> bool:
    """Whether one of `processes` holds the socket `inode`."""
    wanted = f"socket:[{inode}]"
    return any(wanted in _sockets(process) for process in processes)


def _sockets(process: int) -> Iterable[str]:
    directory = _PROC / str(process) / "fd"
    try:
        names = os.listdir(directory)  # noqa: PTH208 - as above
    except OSError:  # gone, or not ours to look into: then it is not our program either
        return
    for name in names:
        try:
            yield os.readlink(directory / name)  # noqa: PTH115 - a bare string is what is compared
        except OSError:
            continue
