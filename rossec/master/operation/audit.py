"""The audit: what was denied and what was administered, line by line, each bound to the one before.

A line is a JSON object; its `hash` is SHA-256 over the hash of the line before and the line without
it. So a line cannot be changed, dropped or put in between without the rest of the file saying so.
That the *beginning* was cut off shows by the signed line a file begins with (`auditmark`); that the
*end* was, only whoever holds an earlier hash can tell, therefore `rossec audit --verify` prints the
last one. Pure but for `AuditFile`, which appends for its owner alone (0600).

Each line is with the kernel at once and on the disk within a second of the first one not yet there.
When the file is moved away (logrotate), the next line begins a new one, and the chain goes on. A
line that was cut short (full disk, power failure) is taken away, and the next one says so.
Lines that nodes cause are bounded before they come here: `rossec.master.operation.denial_limit`.
"""

import hashlib
import json
import logging
import os
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from ca.errors import PathRefused
from ca.keys.signer import Signer
from rossec import files
from rossec.clock import time as host_time
from rossec.errors import ConfigurationError
from rossec.master.operation.audit_mark import FIRST, mark
from rossec.ros.text import printable

LEFT_OUT: Final = "left_out"
SYNC_EVERY: Final = 1.0  # seconds
LINE_LIMIT: Final = 8 * 1024
_TAIL: Final = 64 * 1024  # enough to hold the last line
_LATEST: Final = 1 << 40  # seconds since the epoch

_log = logging.getLogger("rossec.master.audit")

Entry = dict[str, Any]


def chained(entry: Entry, before: str) -> Entry:
    """The entry with its hash."""
    text = json.dumps(entry, sort_keys=True, separators=(",", ":"))
    data = f"{before}\n{text}".encode(errors="surrogatepass")  # of a line that somebody else wrote
    return {**entry, "hash": hashlib.sha256(data).hexdigest()}


def encode(entry: Entry) -> str:
    """One line, without its end."""
    return json.dumps(entry, sort_keys=True, separators=(",", ":"))


def salvage(lines: Iterable[str], max_damaged: int | None = None) -> tuple[list[Entry], list[int]]:
    """The entries that can be read, and the numbers of the lines that cannot.

    Nothing is read after `max_damaged` lines that cannot.
    """
    entries, damaged = list[Entry](), list[int]()
    for number, line in enumerate(lines, 1):
        entry = _entry(line)
        if entry is not None:
            entries.append(entry)
            continue
        damaged.append(number)
        if len(damaged) == max_damaged:
            break
    return entries, damaged


def _entry(line: str) -> Entry | None:
    try:
        entry = json.loads(line) if len(line) <= LINE_LIMIT else None
    except (ValueError, RecursionError):
        return None
    match entry:
        case {"hash": str(), "text": str(), "level": str(), "at": int() | float() as at}:
            return entry if 0 <= at < _LATEST else None
        case _:
            return None


def verify(entries: Iterable[Entry], before: str | None = None) -> str:
    """The hash of the last entry, if each continues the one before; `before` the first of them.

    Raises:
        ConfigurationError: something was changed, dropped or put in between.
    """
    last = before
    for number, entry in enumerate(entries, 1):
        rest = {key: value for key, value in entry.items() if key != "hash"}
        link = rest.get("before")
        if not isinstance(link, str) or (last is not None and link != last):
            raise ConfigurationError(f"before line {number} of the audit something is missing")
        if chained(rest, link) != entry:
            raise ConfigurationError(f"line {number} of the audit was changed")
        last = entry["hash"]
    return FIRST if last is None else last


class AuditFile(logging.Handler):
    """Appends what is logged to `rossec.audit`."""

    def __init__(
        self, path: Path, clock: Callable[[], float] = host_time, signer: Signer | None = None
    ) -> None:
        """Begin, or go on with, the file at `path`; `signer` is the master's key.

        Raises:
            PathRefused: somebody else could have written it.
            OSError: it cannot be written.
        """
        super().__init__(logging.INFO)
        self._signer = signer
        self._path = path
        self._clock = clock
        self._file = self._open()
        self._last, self._torn = self._resume()
        self._synced = clock()
        self._failing = False

    def emit(self, record: logging.LogRecord) -> None:
        """Write one line."""
        now = self._clock()
        entry: Entry = {
            "at": round(now, 3), "level": record.levelname.lower(),
            "text": printable(record.getMessage(), LINE_LIMIT // 8),
        }  # fmt: skip
        if left_out := getattr(record, LEFT_OUT, 0):
            entry[LEFT_OUT] = left_out
        if self._torn:
            entry["cut_short"] = self._torn
        try:
            self._reopen_if_moved()
            self._write_mark(round(now, 3))
            self._append(chained({**entry, "before": self._last}, self._last))
            self._torn, self._failing = 0, False
        except (OSError, PathRefused) as error:
            self._fail(error)
        if now - self._synced >= SYNC_EVERY or now < self._synced:
            self.sync()

    def sync(self) -> None:
        """Put what was written on the disk."""
        self._synced = self._clock()
        with suppress(OSError):
            os.fdatasync(self._file)

    def close(self) -> None:
        """Sync and close the file."""
        if self._file >= 0:
            self.sync()
            os.close(self._file)
            self._file = -1
        super().close()

    def _write_mark(self, at: float) -> None:
        """A file that is empty begins with a line only the master can write."""
        if self._signer is not None and os.fstat(self._file).st_size == 0:
            self._append(chained(mark(self._signer, self._last, at), self._last))

    def _append(self, entry: Entry) -> None:
        line = f"{encode(entry)}\n".encode()
        size = os.fstat(self._file).st_size
        if os.write(self._file, line) != len(line):
            os.ftruncate(self._file, size)  # half a line would be damage for ever
            raise OSError("the disk is full")
        self._last = entry["hash"]

    def _fail(self, error: Exception) -> None:
        """Say so once; to end the master is no answer to a full disk."""
        if not self._failing:
            _log.error("the audit cannot be written: %s; its lines so far are whole", error)
        self._failing = True

    def _reopen_if_moved(self) -> None:
        try:
            there = self._path.stat()
        except FileNotFoundError:
            there = None
        here = os.fstat(self._file)
        if there is None or (there.st_dev, there.st_ino) != (here.st_dev, here.st_ino):
            # First the new one: a number that is closed and kept may soon be somebody else's.
            self._file, old = self._open(), self._file
            os.close(old)

    def _open(self) -> int:
        return files.append_own(self._path)

    def _resume(self) -> tuple[str, int]:
        """The hash to continue from; and how much was left of a line that was cut short."""
        size = os.fstat(self._file).st_size
        tail = os.pread(self._file, _TAIL, max(0, size - _TAIL))
        torn = len(tail) - (tail.rfind(b"\n") + 1)
        if torn:
            os.ftruncate(self._file, size - torn)
        lines = tail[: len(tail) - torn].decode(errors="replace").splitlines()
        entries, _ = salvage(lines)  # of the first of them the beginning may be missing
        return (entries[-1]["hash"] if entries else FIRST), torn
