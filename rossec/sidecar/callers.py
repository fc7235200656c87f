"""Which programs of this host may use the sidecar's loopback ports, and be reached by it.

The kernel's socket table tells the user at the other end. A private sidecar also wants the socket
to be held by the program it was started for, or a descendant of it: another program of the same
user is refused. What this cannot keep out: root, and a program of the same user that attaches to
one of these (ptrace) or reads the identity's files.
"""

import os
import socket
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Final

from rossec.errors import PeerUserRefused
from rossec.net import peeruid
from rossec.net.peeruid import Holder

_PROC: Final = Path("/proc")
_HINT: Final = "start it with `rossec run`"


class Callers:
    """Who may call.

    Args:
        users: their user ids.
        ancestor: the process whose descendants may; None: any process of these users.
    """

    def __init__(self, users: Collection[int], ancestor: int | None = None) -> None:
        self._users = frozenset(users)
        self._ancestor = ancestor

    def check(self, sock: socket.socket) -> None:
        """Return if a program that may is at the other end.

        Raises:
            PeerUserRefused: it may not, or nobody knows who it is.
        """
        self._check(peeruid.holder_of(sock))

    def check_listener(self, port: int) -> None:
        """Return if whoever listens at the loopback port `port` may be reached.

        Raises:
            PeerUserRefused: one of those who listen there may not.
            ConnectionRefusedError: nobody does.
        """
        holders = peeruid.listeners_in(peeruid.tables(), port)
        if not holders:
            raise ConnectionRefusedError(f"nobody listens at port {port}")
        for holder in holders:
            self._check(holder)

    def _check(self, holder: Holder) -> None:
        if holder.user not in self._users:
            raise PeerUserRefused(f"user {holder.user} may not use this sidecar", _HINT)
        if self._ancestor is not None and not held_by(
            holder.inode, descendants(parents(), self._ancestor)
        ):
            raise PeerUserRefused("this sidecar belongs to another program", _HINT)


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
            try:
                stat = (_PROC / entry / "stat").read_bytes()
            except OSError:  # gone meanwhile
                continue
            # The program's name, in parentheses, may hold anything; after the last one it is plain.
            yield int(entry), int(stat.rpartition(b")")[2].split()[1])


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
