"""The file in which the master stores deposited grants: a journal, compacted when it has grown.

A shell. A deposit is synced before it is acknowledged: the authority's operator is told that the
master has it, and may switch off his machine. That a holder has presented a grant is written in the
next maintenance round; if it is lost, the node presents it again.
"""

import logging
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from ca.keys import ownership
from rossec import files
from rossec.errors import NotWritten
from rossec.master.rights.deposits import Deposits, VerifyDeposit
from rossec.master.state import deposit_journal
from rossec.master.state.deposit_journal import DepositChange

REWRITE_FACTOR: Final = 4  # compacted when it is this many times as long as needed
REWRITE_MIN: Final = 1024 * 1024  # and at least this long

_log = logging.getLogger("rossec.master.memory")


class DepositFile:
    """The journal at `path`; `deposits` is its content, to be changed by the master only."""

    def __init__(self, path: Path, verify: VerifyDeposit) -> None:
        self.deposits = Deposits(verify, self._append)
        self._path = path
        self._file: int | None = None
        self._size = self._snapshot_size = 0

    def open(self) -> None:
        """Read the file, truncate an incomplete record, and open it for appending.

        Raises:
            NotWritten, OSError: it cannot be written or read; it is unchanged.
            PathRefused: another user could have written it.
        """
        data = self._read()
        changes, valid = deposit_journal.decode(data)
        if valid < len(data):
            _log.warning("%s: the last %d bytes are damaged", self._path.name, len(data) - valid)
            files.replace(self._path.with_suffix(".damaged"), data)
        self.deposits.restore(changes)
        self._rewrite()

    def sync(self) -> None:
        """Write what was presented since; compact the file when it has grown too long."""
        unsaved = self.deposits.unsaved
        if self._file is None or not (unsaved or self._is_long()):
            return
        try:
            if self._is_long():
                self._rewrite()
            else:
                self._append(unsaved)
        except (NotWritten, OSError) as error:
            _log.warning("%s is not up to date: %s", self._path.name, error)
            return
        unsaved.clear()

    def close(self) -> None:
        """Write what is not written yet, and close."""
        self.sync()
        if self._file is not None:
            os.close(self._file)
            self._file = None

    def _append(self, changes: Sequence[DepositChange]) -> None:
        """Write and sync changes.

        Raises:
            NotWritten: the disk refused them; the file is unchanged.
        """
        if self._file is None:
            raise NotWritten(f"{self._path} is not open", "restart the master")
        records = b"".join(map(deposit_journal.encode, changes))
        try:
            written = os.write(self._file, records)
            if written == len(records):
                os.fdatasync(self._file)
                self._size += written
                return
            reason = "the disk is full"
        except OSError as error:
            reason = str(error)
        os.ftruncate(self._file, self._size)  # half a record would end the journal
        raise NotWritten(f"{self._path.name} was not written: {reason}", "make room on the disk")

    def _is_long(self) -> bool:
        return self._size > max(REWRITE_MIN, REWRITE_FACTOR * self._snapshot_size)

    def _read(self) -> bytes:
        if not self._path.exists():
            return b""
        with os.fdopen(ownership.open_trusted(self._path), "rb") as file:
            return file.read()

    def _rewrite(self) -> None:
        records = map(deposit_journal.encode, self.deposits.changes())
        data = deposit_journal.MAGIC + b"".join(records)
        files.replace(self._path, data)
        if self._file is not None:  # of the old file: what is appended there would be lost
            os.close(self._file)
            self._file = None
        flags = os.O_WRONLY | os.O_APPEND | os.O_CLOEXEC | os.O_NOFOLLOW
        self._file = os.open(self._path, flags)
        self._size = self._snapshot_size = len(data)
