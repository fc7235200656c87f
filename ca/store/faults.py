"""SQLite errors as `StoreError`: whether the record is damaged, or only cannot be used now.

A damaged record must be restored. A full disk, or another running command, is no reason to: a
backup lacks the revocations made since. So only what SQLite reports as corrupt is called damaged,
and every other message says that nothing was changed (https://sqlite.org/rescode.html).
"""

import os
import sqlite3
from contextlib import suppress
from pathlib import Path
from typing import Final

from ca.errors import RecordUnusable, StoreError

_FULL_HINT: Final = "make room and run the command again; do not restore a backup"
_MIN_FREE: Final = 128 * 1024  # bytes of free space that SQLite needs to open a record
_DAMAGED: Final = frozenset({sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB})
_FAULTS: Final[dict[int, tuple[str, str]]] = {
    sqlite3.SQLITE_FULL: ("the disk is full, nothing was changed", _FULL_HINT),
    sqlite3.SQLITE_BUSY: (
        "another command is using it, nothing was changed",
        "run the command again when that one has ended",
    ),
    sqlite3.SQLITE_READONLY: (
        "it is read-only, nothing was changed",
        "is the file system mounted read-only, or the file another user's?",
    ),
    sqlite3.SQLITE_IOERR: (
        "the disk reports an error, nothing was changed",
        "is it full or failing? see: df, dmesg; check the record: rossec ca log verify",
    ),
}


def fault(path: Path, error: sqlite3.Error) -> StoreError:
    """The exception to raise for an SQLite `error` of the record at `path`."""
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
