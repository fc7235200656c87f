"""The file in which the master keeps its parameters: a journal, rewritten when it has grown.

A shell. Every change is with the kernel before the call is answered, so the death of the master
loses nothing; it is on the disk at the next beat, at most ten seconds later, so a power failure may
lose those. Registrations are not kept: nodes register again as soon as they find the master back,
and a node that died meanwhile would only be a ghost.
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

REWRITE_FACTOR: Final = 4  # rewritten when it is so many times as long as it need be
REWRITE_MIN: Final = 1024 * 1024  # and at least this long
MAX_UNSYNCED: Final = 256 * 1024 * 1024  # what may come between two beats

_IN_FORCE: Final = "they are in force, and kept as soon as there is room"

_log = logging.getLogger("rossec.master.memory")


class ParameterFile:
    """The journal at `path`; `parameters` are what it says, to be changed by the master alone."""

    def __init__(self, path: Path) -> None:
        self.parameters = Parameters()
        self._path = path
        self._file: int | None = None
        self._size = self._snapshot_size = 0
        self._dirty = False
        self._complete = True  # False: a change is missing in it

    def open(self) -> None:
        """Read the file, cut off what was not written to its end, and get ready to append.

        Raises:
            NotWritten, OSError: it cannot be written or read; it is as it was.
            PathRefused: somebody else could have written it.
        """
        data = self._read()
        changes, good = parameter_journal.decode(data)
        if good < len(data):
            _log.warning("%s: the last %d bytes are damaged", self._path.name, len(data) - good)
            if data:
                files.replace(self._path.with_suffix(".damaged"), data)
        parameter_journal.replay(self.parameters, changes)
        self._rewrite()

    def write(self, change: ParameterChange) -> None:
        """Append a change that has been made; with the kernel on return."""
        if self._file is None:
            return
        record = parameter_journal.encode(change)
        written, reason = 0, "the disk is full"
        try:
            written = os.write(self._file, record)
        except OSError as error:  # the answer must not depend on it: the change was made
            reason = str(error)
        self._dirty = True
        if written != len(record):
            _log.error("parameters cannot be kept: %s; %s", reason, _IN_FORCE)
            os.ftruncate(self._file, self._size)  # half a record would hide what follows
            self._complete = False
            return
        self._size += len(record)
        if (
            self._size > self._snapshot_size + MAX_UNSYNCED
        ):  # whoever sets without end must not fill the disk
            self.sync()

    def sync(self) -> None:
        """Put what was written on the disk; rewrite the file when it has grown too long."""
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
            _log.error("parameters cannot be kept: %s; %s", error, _IN_FORCE)

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
