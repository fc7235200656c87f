"""What a failure of SQLite says to a person: what happened to the record, and what did not.

A record that is damaged is restored; a disk that is full, or another command at work, is no reason
to: a backup forgets what was revoked since. So only what SQLite itself calls corrupt is called
damaged here, and everything else says that nothing was changed (https://sqlite.org/rescode.html).
"""

import os
import sqlite3
from contextlib import suppress
from pathlib import Path
from typing import Final

from ca.errors import RecordUnusable, StoreError

_FULL_HINT: Final = "make room and run the command again; do not restore a backup"
_MIN_FREE: Final = 128 * 1024  # bytes that SQLite needs beside a record to open it
_DAMAGED: Final = frozenset({sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB})
_FAULTS: Final[dict[int, tuple[str, str]]] = {
    sqlite3.SQLITE_FULL: ("the disk is full, nothing was changed", _FULL_HINT),
    sqlite3.SQLITE_BUSY: (
        "another command is at work on it, nothing was changed",
        "run the command again when that one has ended",
    ),
    sqlite3.SQLITE_READONLY: (
        "it may only be read here, nothing was changed",
        "is the file system mounted read-only, or the file another user's?",
    ),
    sqlite3.SQLITE_IOERR: (
        "the disk refuses, nothing was changed",
        "is it full or failing? see: df, dmesg; a whole record says so: rossec ca log verify",
    ),
}


def fault(path: Path, error: sqlite3.Error) -> StoreError:
    """What `error` means for the record at `path`, as a refusal to raise."""
    code = getattr(error, "sqlite_errorcode", sqlite3.SQLITE_ERROR) & 0xFF  # the primary code
    if code in _DAMAGED:
        return RecordUnusable(
            f"{path} is damaged: {error}", "restore it from a backup, with --list"
        )
    if code == sqlite3.SQLITE_CONSTRAINT:
        return StoreError(f"the record refuses the entry: {error}")
    if code in {sqlite3.SQLITE_IOERR, sqlite3.SQLITE_CANTOPEN} and _is_full(path.parent):
        code = sqlite3.SQLITE_FULL
    what, hint = _FAULTS.get(code, (f"{error}, nothing was changed", "run the command again"))
    return RecordUnusable(f"{path} cannot be used: {what}", hint)


def _is_full(directory: Path) -> bool:
    with suppress(OSError):
        found = os.statvfs(directory)
        return found.f_bavail * found.f_frsize < _MIN_FREE
    return False
