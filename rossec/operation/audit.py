"""The audit log: denials and administrative actions, one a line, in a hash chain.

A line is a JSON object; its `hash` is SHA-256 over the hash of the line before and the line without
it. So a line cannot be changed, removed or inserted without breaking the chain. A removed
*beginning* is detected by the signed line a file begins with (`audit_mark`); a removed *end* only
by comparison with a later hash, so `rossec audit --verify` prints the last one. Pure except for
`AuditFile`, which appends to a file of its owner alone (0600).

Each line is written at once and synced within a second of the first line not yet synced. When the
file is moved away (logrotate), the next line begins a new file, and the chain continues. A line
that was truncated (full disk, power failure) is removed, and the next one records that.
The rate of lines that nodes cause is limited before: `rossec.master.operation.denial_limit`.
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
from rossec.operation.audit_mark import FIRST, mark
from rossec.ros.text import printable

LEFT_OUT: Final = "left_out"
SYNC_EVERY: Final = 1.0  # seconds
LINE_LIMIT: Final = 8 * 1024
_TAIL: Final = 64 * 1024  # enough to hold the last line
_LATEST: Final = 1 << 40  # seconds since the epoch

_log = logging.getLogger("rossec.master.audit")

Entry = dict[str, Any]


def with_hash(entry: Entry, before: str) -> Entry:
    """The entry with its hash."""
    text = json.dumps(entry, sort_keys=True, separators=(",", ":"))
    data = f"{before}\n{text}".encode(
        errors="surrogatepass"
    )  # a foreign line may contain surrogates
    return {**entry, "hash": hashlib.sha256(data).hexdigest()}


def encode(entry: Entry) -> str:
    """One line, without the line break."""
    return json.dumps(entry, sort_keys=True, separators=(",", ":"))


def read_entries(
    lines: Iterable[str], max_damaged: int | None = None
) -> tuple[list[Entry], list[int]]:
    """The valid entries, and the numbers of the damaged lines.

    Reading ends after `max_damaged` damaged lines.
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
    """The hash of the last entry, if the chain is intact; `before` is the hash before the first.

    Raises:
        ConfigurationError: a line was changed, removed or inserted.
    """
    last = before
    for number, entry in enumerate(entries, 1):
        rest = {key: value for key, value in entry.items() if key != "hash"}
        link = rest.get("before")
        if not isinstance(link, str) or (last is not None and link != last):
            raise ConfigurationError(f"before line {number} of the audit something is missing")
        if with_hash(rest, link) != entry:
            raise ConfigurationError(f"line {number} of the audit was changed")
        last = entry["hash"]
    return FIRST if last is None else last


class AuditFile(logging.Handler):
    """Appends what is logged to `rossec.audit`."""

    def __init__(
        self, path: Path, clock: Callable[[], float] = host_time, signer: Signer | None = None
    ) -> None:
        """Begin or continue the file at `path`; `signer` has the master's key.

        Raises:
            PathRefused: another user could have written it.
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
            self._append(with_hash({**entry, "before": self._last}, self._last))
            self._torn, self._failing = 0, False
        except (OSError, PathRefused) as error:
            self._fail(error)
        if now - self._synced >= SYNC_EVERY or now < self._synced:
            self.sync()

    @property
    def is_failing(self) -> bool:
        """Whether the last line could not be written."""
        return self._failing

    def sync(self) -> None:
        """Sync what was written to the disk."""
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
        """Begin an empty file with a line that is signed by the master."""
        if self._signer is not None and os.fstat(self._file).st_size == 0:
            self._append(with_hash(mark(self._signer, self._last, at), self._last))

    def _append(self, entry: Entry) -> None:
        line = f"{encode(entry)}\n".encode()
        size = os.fstat(self._file).st_size
        if os.write(self._file, line) != len(line):
            os.ftruncate(self._file, size)  # half a line would stay damaged
            raise OSError("the disk is full")
        self._last = entry["hash"]

    def _fail(self, error: Exception) -> None:
        """Log the first failure; a full disk must not end the master."""
        if not self._failing:
            _log.error("the audit cannot be written: %s; the lines before are intact", error)
        self._failing = True

    def _reopen_if_moved(self) -> None:
        try:
            there = self._path.stat()
        except FileNotFoundError:
            there = None
        here = os.fstat(self._file)
        if there is None or (there.st_dev, there.st_ino) != (here.st_dev, here.st_ino):
            # Open first: the number of a closed descriptor may be reused.
            self._file, old = self._open(), self._file
            os.close(old)

    def _open(self) -> int:
        return files.append_own(self._path)

    def _resume(self) -> tuple[str, int]:
        """The hash to continue from, and the length of a truncated line, which is removed."""
        size = os.fstat(self._file).st_size
        tail = os.pread(self._file, _TAIL, max(0, size - _TAIL))
        torn = len(tail) - (tail.rfind(b"\n") + 1)
        if torn:
            os.ftruncate(self._file, size - torn)
        lines = tail[: len(tail) - torn].decode(errors="replace").splitlines()
        entries, _ = read_entries(lines)  # the first may be incomplete
        return (entries[-1]["hash"] if entries else FIRST), torn
