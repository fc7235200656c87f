"""The processes of this host in /proc: their parents and their sockets.

A PID alone does not identify a process: PIDs are reused. A process is identified by PID and start
time, and starts no earlier than its parent: a chain of parents that violates this contains a PID
that was reused while the chain was read.
"""

import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final, NamedTuple

PROC: Final = Path("/proc")
_MAX_STAT: Final = 4096  # usually some 300 bytes
_PARENT, _STARTED = 1, 19  # proc_pid_stat(5), counted from after the program's name


class Process(NamedTuple):
    """One process; `started` is in clock ticks since boot."""

    pid: int
    started: int


def parents() -> Iterator[tuple[int, int]]:
    """The PID of each process of this host, with its parent's."""
    for entry in os.listdir(PROC):  # noqa: PTH208 - names only, and many
        if entry.isdecimal():
            stat = _status(int(entry))
            if stat is not None:
                yield int(entry), stat[0]


def descendants(parents: Iterable[tuple[int, int]], ancestor: int) -> list[int]:
    """The descendants of `ancestor`, from pairs of PID and parent PID. Pure."""
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
    """The process that has this PID now."""
    stat = _status(pid)
    return None if stat is None else Process(pid, stat[1])


def descends(pid: int, ancestor: int) -> bool:
    """Whether the process with this PID is alive and a descendant of `ancestor`."""
    child_started: int | None = None
    while pid > 1:
        stat = _status(pid)
        if stat is None:
            return False
        parent, started = stat
        if child_started is not None and started > child_started:
            return False
        if parent == ancestor:
            return True
        pid, child_started = parent, started
    return False


def _status(pid: int) -> tuple[int, int] | None:
    """Its parent PID and start time."""
    try:
        with open(f"{PROC}/{pid}/stat", "rb", buffering=0) as file:  # noqa: PTH123 - often
            stat = file.read(_MAX_STAT)
    except OSError:  # it has ended
        return None
    # The program name in parentheses may contain anything, also parentheses.
    fields = stat.rpartition(b")")[2].split()
    return int(fields[_PARENT]), int(fields[_STARTED])


def descriptors(pid: int) -> list[str]:
    """The names of its open descriptors; empty if it has ended or is not accessible."""
    try:
        return os.listdir(f"{PROC}/{pid}/fd")  # noqa: PTH208 - as above
    except OSError:
        return []


def socket_at(pid: int, descriptor: str) -> int | None:
    """The inode of the socket at a descriptor of a process; None: not a socket."""
    try:
        target = os.readlink(f"{PROC}/{pid}/fd/{descriptor}")  # noqa: PTH115 - takes a str
    except OSError:
        return None
    return int(target[8:-1]) if target.startswith("socket:[") else None
