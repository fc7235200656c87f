"""The file in which the master stores its parameters: a journal, compacted when it has grown.

A shell. Every change is written before the call is answered, so a crash of the master loses none;
it is synced in the next maintenance round, at most ten seconds later, so a power failure may lose
these. Registrations are not stored: nodes register again with a restarted master, and a node that
died meanwhile would stay registered.
"""

import logging
import os
from pathlib import Path
from typing import Final

from ca.keys import ownership
from rossec import files
from rossec.errors import NotWritten
from rossec.master.state import parameter_journal
from rossec.master.state.parameter_journal import ParameterChange
from rossec.master.state.parameters import Parameters

REWRITE_FACTOR: Final = 4  # compacted when it is this many times as long as a snapshot
REWRITE_MIN: Final = 1024 * 1024  # and at least this long
MAX_UNSYNCED: Final = 256 * 1024 * 1024  # bytes written between two rounds

_IN_FORCE: Final = "they are in force, and saved as soon as there is room"

_log = logging.getLogger("rossec.master.memory")


class ParameterFile:
    """The journal at `path`; `parameters` is its content, to be changed by the master only."""

    def __init__(self, path: Path) -> None:
        self.parameters = Parameters()
        self._path = path
        self._file: int | None = None
        self._size = self._snapshot_size = 0
        self._dirty = False
        self._complete = True  # False: a change is missing in the file

    def open(self) -> None:
        """Read the file, truncate an incomplete record, and open it for appending.

        Raises:
            NotWritten, OSError: it cannot be written or read; it is unchanged.
            PathRefused: another user could have written it.
        """
        data = self._read()
        changes, valid = parameter_journal.decode(data)
        if valid < len(data):
            _log.warning("%s: the last %d bytes are damaged", self._path.name, len(data) - valid)
            if data:
                files.replace(self._path.with_suffix(".damaged"), data)
        parameter_journal.replay(self.parameters, changes)
        self._rewrite()

    def write(self, change: ParameterChange) -> None:
        """Append a change that has been made; written, not synced, on return."""
        if self._file is None:
            return
        record = parameter_journal.encode(change)
        written, reason = 0, "the disk is full"
        try:
            written = os.write(self._file, record)
        except OSError as error:  # the call succeeds all the same: the change was made
            reason = str(error)
        self._dirty = True
        if written != len(record):
            _log.error("parameters cannot be saved: %s; %s", reason, _IN_FORCE)
            os.ftruncate(self._file, self._size)  # half a record would end the journal
            self._complete = False
            return
        self._size += len(record)
        if (
            self._size > self._snapshot_size + MAX_UNSYNCED
        ):  # a caller that sets without end must not fill the disk
            self.sync()

    def sync(self) -> None:
        """Sync the file to the disk; compact it when it has grown too long."""
        if self._file is None or not self._dirty:
            return
        self._dirty = False
        try:
            if (
                self._size > max(REWRITE_MIN, REWRITE_FACTOR * self._snapshot_size)
                or not self._complete
            ):
                self._rewrite()
            else:
                os.fdatasync(self._file)
        except (NotWritten, OSError) as error:
            self._dirty = True
            _log.error("parameters cannot be saved: %s; %s", error, _IN_FORCE)

    def close(self) -> None:
        """Sync and close."""
        self.sync()
        if self._file is not None:
            os.close(self._file)
            self._file = None

    def _read(self) -> bytes:
        if not self._path.exists():
            return b""
        with os.fdopen(ownership.open_trusted(self._path), "rb") as file:
            return file.read()

    def _rewrite(self) -> None:
        data = parameter_journal.snapshot(self.parameters)
        files.replace(self._path, data)
        old = self._file
        flags = os.O_WRONLY | os.O_APPEND | os.O_CLOEXEC | os.O_NOFOLLOW
        self._file = os.open(self._path, flags)
        self._size = self._snapshot_size = len(data)
        self._complete = True
        if old is not None:
            os.close(old)
