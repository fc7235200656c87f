"""The processes of this host as /proc shows them: who descends from whom, who has which socket.

A number alone names no process: it is given again. A process is its number and when it started,
and it started no earlier than its parent: a chain of parents in which one did is made of numbers
that changed hands while it was read.
"""

import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final, NamedTuple

_PROC: Final = Path("/proc")
_LONGEST: Final = 4096  # it is some 300 bytes
_PARENT, _STARTED = 1, 19  # proc_pid_stat(5), counted from after the program's name


class Process(NamedTuple):
    """One process; `started` is in clock ticks since the host's start."""

    number: int
    started: int


def parents() -> Iterator[tuple[int, int]]:
    """Each process of this host with its parent."""
    for entry in os.listdir(_PROC):  # noqa: PTH208 - names alone, and there are many
        if entry.isdecimal():
            found = _status(int(entry))
            if found is not None:
                yield int(entry), found[0]


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


def process(number: int) -> Process | None:
    """The process that has this number now."""
    found = _status(number)
    return None if found is None else Process(number, found[1])


def descends(number: int, ancestor: int) -> bool:
    """Whether the process with this number is alive and below `ancestor`."""
    child_started: int | None = None
    while number > 1:
        found = _status(number)
        if found is None:
            return False
        parent, started = found
        if child_started is not None and started > child_started:
            return False
        if parent == ancestor:
            return True
        number, child_started = parent, started
    return False


def _status(number: int) -> tuple[int, int] | None:
    """Its parent, and when it started."""
    try:
        with open(f"{_PROC}/{number}/stat", "rb", buffering=0) as file:  # noqa: PTH123 - often
            stat = file.read(_LONGEST)
    except OSError:  # gone meanwhile
        return None
    # The program's name, in parentheses, may hold anything; after the last one it is plain.
    fields = stat.rpartition(b")")[2].split()
    return int(fields[_PARENT]), int(fields[_STARTED])


def descriptors(number: int) -> list[str]:
    """The names of its open descriptors; none of a process that is gone, or not ours to see."""
    try:
        return os.listdir(f"{_PROC}/{number}/fd")  # noqa: PTH208 - as above
    except OSError:
        return []


def socket_at(number: int, descriptor: str) -> int | None:
    """The inode of the socket that a process has at a descriptor; None: it has none there."""
    try:
        target = os.readlink(f"{_PROC}/{number}/fd/{descriptor}")  # noqa: PTH115 - a bare string
    except OSError:
        return None
    return int(target[8:-1]) if target.startswith("socket:[") else None
