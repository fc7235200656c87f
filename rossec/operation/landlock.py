"""Let this process open no files but some, for reading: Landlock of Linux 5.13 and later.

For a process that talks to strangers, beside files of the same user that it must not get: once
confined, neither it nor what it starts opens anything else (landlock(7)). Files that are open stay
open. Only the calling thread and those it starts later are confined: call it first of all.
"""

import ctypes
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Final

_CREATE_RULESET, _ADD_RULE, _RESTRICT_SELF = 444, 445, 446  # the same on every architecture
_PATH_BENEATH: Final = 1
_READ_FILE: Final = 1 << 2
_READ: Final = _READ_FILE | 1 << 3  # and directories
_ALL: Final = (1 << 13) - 1  # every access that the first version of Landlock knows
_PR_SET_NO_NEW_PRIVS: Final = 38
LIBC: Final = ctypes.CDLL(None, use_errno=True)


class _Ruleset(ctypes.Structure):
    """struct landlock_ruleset_attr, of the first version."""

    _fields_ = (("handled_access_fs", ctypes.c_uint64),)


class _PathBeneath(ctypes.Structure):
    """struct landlock_path_beneath_attr."""

    _pack_ = 1
    _fields_ = (("allowed_access", ctypes.c_uint64), ("parent_fd", ctypes.c_int32))


def read_only(paths: Iterable[Path]) -> None:
    """Open nothing from now on but what is at or below `paths`, for reading; others may be missing.

    Raises:
        OSError: this kernel has no Landlock, or refuses; nothing is confined.
    """
    attributes = _Ruleset(_ALL)
    ruleset = _call(_CREATE_RULESET, ctypes.byref(attributes), ctypes.sizeof(attributes), 0)
    try:
        for path in paths:
            _allow(ruleset, path)
        if LIBC.prctl(_PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) != 0:
            raise OSError(ctypes.get_errno(), "prctl")
        _call(_RESTRICT_SELF, ruleset, 0)
    finally:
        os.close(ruleset)


def _allow(ruleset: int, path: Path) -> None:
    try:
        descriptor = os.open(path, os.O_PATH | os.O_CLOEXEC)
    except FileNotFoundError:
        return
    try:
        rule = _PathBeneath(_READ if path.is_dir() else _READ_FILE, descriptor)
        _call(_ADD_RULE, ruleset, _PATH_BENEATH, ctypes.byref(rule), 0)
    finally:
        os.close(descriptor)


def _call(number: int, *arguments: object) -> int:
    result: int = LIBC.syscall(number, *arguments)
    if result < 0:
        error = ctypes.get_errno()
        raise OSError(error, f"Landlock: {os.strerror(error)}")
    return result
