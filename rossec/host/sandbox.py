"""Confinement of this process by the kernel: what it opens (Landlock), what it calls (seccomp), who reads its
memory.
"""

import ctypes
import os
import platform
import resource
import struct
import sys
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Final

_CREATE_RULESET, _ADD_RULE, _RESTRICT_SELF = 444, 445, 446  # the same on every architecture
_PATH_BENEATH: Final = 1
_READ_FILE: Final = 1 << 2
_READ: Final = _READ_FILE | 1 << 3  # and directories
_ALL: Final = (1 << 13) - 1  # every access that the first version of Landlock knows
_PR_GET_DUMPABLE: Final = 3
_PR_SET_DUMPABLE: Final = 4
_PR_SET_NO_NEW_PRIVS: Final = 38
LIBC: Final = ctypes.CDLL(None, use_errno=True)


class _Ruleset(ctypes.Structure):
    _fields_ = (("handled_access_fs", ctypes.c_uint64),)


class _PathBeneath(ctypes.Structure):
    _pack_ = 1
    _fields_ = (("allowed_access", ctypes.c_uint64), ("parent_fd", ctypes.c_int32))


# Landlock (Linux 5.13, landlock(7)): once confined, neither the process nor what it starts opens anything
# but some files, for reading; files that are open stay open. Only the calling thread and those it starts
# later are confined: call it first of all.
def read_only(paths: Iterable[Path]) -> None:
    attributes = _Ruleset(_ALL)
    ruleset = _call(_CREATE_RULESET, ctypes.byref(attributes), ctypes.sizeof(attributes), 0)
    try:
        for path in paths:
            with suppress(FileNotFoundError):  # not every system has every path
                descriptor = os.open(path, os.O_PATH | os.O_CLOEXEC)
                try:
                    rule = _PathBeneath(_READ if path.is_dir() else _READ_FILE, descriptor)
                    _call(_ADD_RULE, ruleset, _PATH_BENEATH, ctypes.byref(rule), 0)
                finally:
                    os.close(descriptor)
        if LIBC.prctl(_PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) != 0:
            raise OSError(ctypes.get_errno(), "prctl")
        _call(_RESTRICT_SELF, ruleset, 0)
    finally:
        os.close(ruleset)


def _call(number: int, *arguments: object) -> int:
    result: int = LIBC.syscall(number, *arguments)
    if result < 0:
        error = ctypes.get_errno()
        raise OSError(error, f"Landlock: {os.strerror(error)}")
    return result


# Seccomp (Linux 3.17): limits of resources do not bind root; a filter binds everybody, cannot be taken back,
# and is inherited. A call that is not on the list fails with EPERM; so does one of x32, whose numbers are
# others.
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
    "brk": (12, 214),
    "clock_gettime": (228, 113),
    "clone": (56, 220),
    "close": (3, 57),
    "exit": (60, 93),
    "exit_group": (231, 94),
    "fstat": (5, 80),
    "futex": (202, 98),
    "getpid": (39, 172),
    "getppid": (110, 173),
    "getrandom": (318, 278),
    "gettid": (186, 178),
    "kill": (62, 129),
    "lseek": (8, 62),
    "madvise": (28, 233),
    "mmap": (9, 222),
    "mprotect": (10, 226),
    "mremap": (25, 216),
    "munmap": (11, 215),
    "pipe2": (293, 59),
    "prctl": (157, 167),
    "prlimit64": (302, 261),
    "read": (0, 63),
    "readv": (19, 65),
    "restart_syscall": (219, 128),
    "rseq": (334, 293),
    "rt_sigaction": (13, 134),
    "rt_sigprocmask": (14, 135),
    "rt_sigreturn": (15, 139),
    "sched_yield": (24, 124),
    "set_robust_list": (273, 99),
    "wait4": (61, 260),
    "write": (1, 64),
}


class _Program(ctypes.Structure):
    _fields_ = (("length", ctypes.c_ushort), ("instructions", ctypes.c_char_p))


def allow_only(names: Iterable[str]) -> None:
    """Make no system call from now on but those with these names; threads that run are not bound."""
    code = program(names, platform.machine())
    if LIBC.prctl(_PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "prctl")
    filled = _Program(len(code) // 8, code)
    if LIBC.prctl(_PR_SET_SECCOMP, _MODE_FILTER, ctypes.byref(filled), 0, 0) != 0:
        error = ctypes.get_errno()
        raise OSError(error, f"seccomp: {os.strerror(error)}")


def program(names: Iterable[str], machine: str) -> bytes:
    """The filter as the kernel reads it: struct sock_filter, eight bytes each."""
    if machine not in _AUDIT or sys.byteorder != "little":
        raise OSError(f"no filter of system calls is known for {machine}")
    column = list(_AUDIT).index(machine)
    numbers = sorted(_NUMBERS[name][column] for name in set(names) - {FORK})
    fork = [_NUMBERS[FORK][column]] if FORK in set(names) else []
    refuse, allow = (_RETURN, 0, 0, _ERRNO | _EPERM), (_RETURN, 0, 0, _ALLOW)
    found = [
        # Numbers mean other calls on another architecture (a 32-bit program on a 64-bit kernel): end it.
        (_LOAD, 0, 0, _ARCHITECTURE),
        (_JUMP_IF_EQUAL, 1, 0, _AUDIT[machine]),
        (_RETURN, 0, 0, _KILL_PROCESS),
        (_LOAD, 0, 0, _NUMBER),
    ]
    for number in numbers:
        found += [(_JUMP_IF_EQUAL, 0, 1, number), allow]
    for number in fork:
        found += [
            (_JUMP_IF_EQUAL, 0, 5, number),
            (_LOAD, 0, 0, _FIRST_LOW),
            (_JUMP_IF_EQUAL, 0, 3, _FORK),
            (_LOAD, 0, 0, _FIRST_HIGH),
            (_JUMP_IF_EQUAL, 0, 1, 0),
            allow,
        ]
    return b"".join(struct.pack("<HBBI", *instruction) for instruction in [*found, refuse])


def protect_memory() -> None:
    """Let no process of the same user read this one's memory, which holds a key, and write no core file.

    Without this every program of the same user could attach a debugger (ptrace(2), core(5)). Memory that is
    swapped out is not covered: where there is swap it must be encrypted, or kept away by the service manager.
    Programs started later are not affected, but cannot gain privileges (set-user-id).
    """
    _prctl(_PR_SET_DUMPABLE, 0)
    _prctl(_PR_SET_NO_NEW_PRIVS, 1)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def is_protected() -> bool:
    return _prctl(_PR_GET_DUMPABLE, 0) == 0


def _prctl(option: int, value: int) -> int:
    result: int = LIBC.prctl(option, value, 0, 0, 0)
    if result < 0:
        raise OSError(ctypes.get_errno(), f"prctl {option}")
    return result
