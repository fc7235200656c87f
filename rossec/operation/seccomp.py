"""Let this process make no system calls but some: a filter of Linux 3.17 and later (seccomp(2)).

Limits of resources do not bind root, which may start processes whatever RLIMIT_NPROC says; a
filter binds everybody, cannot be taken back, and is inherited. A call that is not on the list fails
with EPERM, so does one of x32; one of another architecture (32 bits) ends the process.
"""

import ctypes
import os
import platform
import struct
import sys
from collections.abc import Iterable, Mapping
from typing import Final

from rossec.operation.landlock import LIBC

_PR_SET_NO_NEW_PRIVS: Final = 38
_PR_SET_SECCOMP: Final = 22
_MODE_FILTER: Final = 2
_LOAD, _JUMP_IF_EQUAL, _RETURN = 0x20, 0x15, 0x06  # of words, absolute, constants
_ALLOW, _KILL_PROCESS, _ERRNO = 0x7FFF0000, 0x80000000, 0x00050000
_NUMBER, _ARCHITECTURE, _FIRST_LOW, _FIRST_HIGH = 0, 4, 16, 20  # offsets in struct seccomp_data
_EPERM: Final = 1
_FORK: Final = 0x01200011  # CLONE_CHILD_CLEARTID, CLONE_CHILD_SETTID, SIGCHLD: what fork() asks for
FORK: Final = "clone"  # in this form only: no threads, no namespaces

# By architecture: its number for audit (linux/audit.h), and those of its calls (asm/unistd.h).
_AUDIT: Final = {"x86_64": 0xC000003E, "aarch64": 0xC00000B7}
_NUMBERS: Final[Mapping[str, tuple[int, int]]] = {
    "brk": (12, 214), "clock_gettime": (228, 113), "clone": (56, 220), "close": (3, 57),
    "exit": (60, 93), "exit_group": (231, 94), "fstat": (5, 80), "futex": (202, 98),
    "getpid": (39, 172), "getppid": (110, 173), "getrandom": (318, 278), "gettid": (186, 178),
    "kill": (62, 129), "lseek": (8, 62), "madvise": (28, 233), "mmap": (9, 222),
    "mprotect": (10, 226), "mremap": (25, 216), "munmap": (11, 215), "pipe2": (293, 59),
    "prctl": (157, 167), "prlimit64": (302, 261), "read": (0, 63), "readv": (19, 65),
    "restart_syscall": (219, 128),
    "rseq": (334, 293), "rt_sigaction": (13, 134), "rt_sigprocmask": (14, 135),
    "rt_sigreturn": (15, 139), "sched_yield": (24, 124), "set_robust_list": (273, 99),
    "wait4": (61, 260), "write": (1, 64),
}  # fmt: skip


class _Program(ctypes.Structure):
    """struct sock_fprog."""

    _fields_ = (("length", ctypes.c_ushort), ("instructions", ctypes.c_char_p))


def allow_only(names: Iterable[str]) -> None:
    """Make no system call from now on but those with these names; threads that run are not bound.

    Raises:
        OSError: this kernel has no filters, or none is known for this architecture.
    """
    code = program(names, platform.machine())
    if LIBC.prctl(_PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "prctl")
    filled = _Program(len(code) // 8, code)
    if LIBC.prctl(_PR_SET_SECCOMP, _MODE_FILTER, ctypes.byref(filled), 0, 0) != 0:
        error = ctypes.get_errno()
        raise OSError(error, f"seccomp: {os.strerror(error)}")


def program(names: Iterable[str], machine: str) -> bytes:
    """The filter as the kernel reads it: struct sock_filter, eight bytes each.

    Raises:
        OSError: nothing is known of `machine`.
    """
    if machine not in _AUDIT or sys.byteorder != "little":
        raise OSError(f"no filter of system calls is known for {machine}")
    column = list(_AUDIT).index(machine)
    numbers = sorted(_NUMBERS[name][column] for name in set(names) - {FORK})
    fork = [_NUMBERS[FORK][column]] if FORK in set(names) else []
    return b"".join(
        struct.pack("<HBBI", *instruction)
        for instruction in _instructions(_AUDIT[machine], numbers, fork)
    )


def _instructions(
    architecture: int, numbers: list[int], fork: list[int]
) -> list[tuple[int, int, int, int]]:
    """Code, how many to skip if equal and if not, constant."""
    refuse, allow = (_RETURN, 0, 0, _ERRNO | _EPERM), (_RETURN, 0, 0, _ALLOW)
    found = [
        (_LOAD, 0, 0, _ARCHITECTURE),
        (_JUMP_IF_EQUAL, 1, 0, architecture),
        (_RETURN, 0, 0, _KILL_PROCESS),
        (_LOAD, 0, 0, _NUMBER),
    ]
    for number in numbers:
        found += [(_JUMP_IF_EQUAL, 0, 1, number), allow]
    for number in fork:
        found += [
            (_JUMP_IF_EQUAL, 0, 5, number),
            (_LOAD, 0, 0, _FIRST_LOW), (_JUMP_IF_EQUAL, 0, 3, _FORK),
            (_LOAD, 0, 0, _FIRST_HIGH), (_JUMP_IF_EQUAL, 0, 1, 0),
            allow,
        ]  # fmt: skip
    return [*found, refuse]
