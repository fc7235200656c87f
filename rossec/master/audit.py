"""The audit: what was denied and what was administered, line by line, each bound to the one before.

A line is a JSON object; its `hash` is SHA-256 over the hash of the line before and the line without
it. So a line cannot be changed, dropped or put in between without the rest of the file saying so;
only whoever holds an earlier hash can tell that the *end* was cut off, therefore `rossec audit
--verify` prints the last one. Pure but for `AuditFile`, which appends for its owner alone (0600).

Each line is with the kernel at once and on the disk within a second of the first one not yet there.
When the file is moved away (logrotate), the next line begins a new one, and the chain goes on.
Lines are bounded in number: whoever is denied a thousand times a second cannot fill the disk; how
many were left out stands in the next line.
"""

import hashlib
import json
import logging
import os
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from rossec.errors import ConfigurationError
from rossec.ros.text import printable

FIRST: Final = "0" * 64
PER_SECOND: Final = 50
BURST: Final = 1000
SYNC_EVERY: Final = 1.0  # seconds
LINE_LIMIT: Final = 8 * 1024

Entry = dict[str, Any]


def chained(entry: Entry, before: str) -> Entry:
    """The entry with its hash."""
    text = json.dumps(entry, sort_keys=True, separators=(",", ":"))
    return {**entry, "hash": hashlib.sha256(f"{before}\n{text}".encode()).hexdigest()}


def encode(entry: Entry) -> str:
    """One line, without its end."""
    return json.dumps(entry, sort_keys=True, separators=(",", ":"))


def read(lines: Iterable[str]) -> Iterator[Entry]:
    """The entries of an audit file.

    Raises:
        ConfigurationError: a line is none; its number is in the message.
    """
    for number, line in enumerate(lines, 1):
        try:
            entry = json.loads(line) if len(line) <= LINE_LIMIT else None
        except ValueError:
            entry = None
        if not isinstance(entry, dict) or not isinstance(entry.get("hash"), str):
            raise ConfigurationError(f"line {number} of the audit is damaged", "compare a backup")
        yield entry


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

    def __init__(self, path: Path, clock: Callable[[], float] = time.time) -> None:
        super().__init__(logging.INFO)
        self._path = path
        self._clock = clock
        self._last = self._newest()
        self._file = self._open()
        self._left = float(BURST)
        self._refilled = self._synced = clock()
        self._suppressed = 0

    def emit(self, record: logging.LogRecord) -> None:
        """Write one line, unless there are too many."""
        now = self._clock()
        self._left = min(float(BURST), self._left + max(0.0, now - self._refilled) * PER_SECOND)
        self._refilled = now
        if self._left < 1:
            self._suppressed += 1
            return
        self._left -= 1
        entry: Entry = {
            "at": round(now, 3), "before": self._last, "level": record.levelname.lower(),
            "text": printable(record.getMessage(), LINE_LIMIT // 8),
        }  # fmt: skip
        if self._suppressed:
            entry["left_out"] = self._suppressed
        try:
            self._append(chained(entry, self._last))
            self._suppressed = 0
        except OSError:
            self.handleError(record)
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

    def _append(self, entry: Entry) -> None:
        self._reopen_if_moved()
        os.write(self._file, f"{encode(entry)}\n".encode())
        self._last = entry["hash"]

    def _reopen_if_moved(self) -> None:
        try:
            there = self._path.stat()
        except FileNotFoundError:
            there = None
        here = os.fstat(self._file)
        if there is None or (there.st_dev, there.st_ino) != (here.st_dev, here.st_ino):
            os.close(self._file)
            self._file = self._open()

    def _open(self) -> int:
        flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW
        return os.open(self._path, flags, 0o600)

    def _newest(self) -> str:
        """The hash to continue from; a line that was cut short is ended by a line feed."""
        if not self._path.exists():
            return FIRST
        last = FIRST
        data = self._path.read_bytes()
        if data and not data.endswith(b"\n"):
            with self._path.open("ab") as file:
                file.write(b"\n")
        for line in data.decode(errors="replace").splitlines():
            with suppress(ConfigurationError):
                last = next(read([line]))["hash"]
        return last
