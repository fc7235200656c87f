"""The file in which the master stores its parameters: a journal, compacted when it has grown.

A shell. Every change is written before the call is answered, so a crash of the master loses none;
it is synced at most ten seconds later, so a power failure may lose these. That, and compacting, is
the work of a thread and of many passes of the loop: a disk may take seconds. Registrations are not
stored: nodes register again with a restarted master, and a node that died meanwhile would stay
registered.
"""

import asyncio
import logging
import os
import secrets
from collections.abc import Callable
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
GROWN: Final = 64 * 1024 * 1024  # bytes written, after which the next round does not wait
MAX_UNSYNCED: Final = 256 * 1024 * 1024  # bytes written between two rounds

_CHUNK: Final = 1024 * 1024  # bytes that are written at a time
_APPEND: Final = os.O_WRONLY | os.O_APPEND | os.O_CLOEXEC | os.O_NOFOLLOW
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
        self._compacted: bytearray | None = None  # what the next file gets, while it is made
        self.grown = asyncio.Event()
        """Whether so much was written that `save` is due now."""

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
        if self._compacted is not None:
            self._compacted += record
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
        if self._has_grown():
            self.grown.set()
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
            if self._is_long():
                self._rewrite()
            else:
                os.fdatasync(self._file)
        except (NotWritten, OSError) as error:
            self._not_saved(error)

    async def save(self) -> None:
        """As `sync`, but the loop goes on meanwhile; one at a time."""
        self.grown.clear()
        if self._file is None or not self._dirty:
            return
        self._dirty = False
        try:
            if self._is_long():
                await self._compact()
            else:
                descriptor = os.dup(self._file)  # the file may be closed meanwhile
                try:
                    await _in_thread(lambda: os.fdatasync(descriptor))
                finally:
                    os.close(descriptor)
        except (NotWritten, OSError) as error:
            self._not_saved(error)
        except BaseException:
            self._dirty = True  # for `close`
            raise

    def _not_saved(self, error: Exception) -> None:
        self._dirty = True
        _log.error("parameters cannot be saved: %s; %s", error, _IN_FORCE)

    def _has_grown(self) -> bool:
        return self._size > self._snapshot_size + GROWN

    def _is_long(self) -> bool:
        long = self._size > max(REWRITE_MIN, REWRITE_FACTOR * self._snapshot_size)
        return long or self._has_grown() or not self._complete

    async def _compact(self) -> None:
        """Make the shortest file piece by piece, with the changes of that time in their order.

        They are in the old file too, which is in its place until the new one is whole.
        """
        temporary = self._path.with_name(f".{self._path.name}.{secrets.token_hex(8)}")
        made = os.open(temporary, _APPEND | os.O_CREAT | os.O_EXCL, 0o600)
        waiting, size = bytearray(), 0
        self._compacted = waiting
        try:
            for piece in parameter_journal.pieces(self.parameters):
                waiting += piece
                await asyncio.sleep(0)
                if len(waiting) >= _CHUNK:
                    size += await self._move(waiting, made)
            while len(waiting) >= _CHUNK:
                size += await self._move(waiting, made)
            await _in_thread(lambda: os.fdatasync(made))
            size += _write_all(made, bytes(waiting))  # as each change is written
            old = self._opened()
            temporary.replace(self._path)
        except BaseException:
            os.close(made)
            temporary.unlink(missing_ok=True)
            raise
        finally:
            self._compacted = None
        self._file = made
        self._size = self._snapshot_size = size
        self._complete = True
        os.close(old)
        await _in_thread(lambda: files.sync_directory(self._path.parent))

    def _opened(self) -> int:
        if self._file is None:
            raise NotWritten(f"{self._path.name} was closed meanwhile", "start the master again")
        return self._file

    @staticmethod
    async def _move(waiting: bytearray, descriptor: int) -> int:
        """Write what waits; returns how much it was."""
        data = bytes(waiting)
        waiting.clear()
        await _in_thread(lambda: _write_all(descriptor, data))
        return len(data)

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
        self._file = os.open(self._path, _APPEND)
        self._size = self._snapshot_size = len(data)
        self._complete = True
        if old is not None:
            os.close(old)


async def _in_thread(work: Callable[[], object]) -> None:
    """Do it in a thread; a caller that is cancelled waits for its end, as it uses a descriptor."""
    done = asyncio.ensure_future(asyncio.to_thread(work))
    try:
        await asyncio.shield(done)
    except asyncio.CancelledError:
        await asyncio.wait([done])
        raise


def _write_all(descriptor: int, data: bytes) -> int:
    view = memoryview(data)
    while view:
        view = view[os.write(descriptor, view) :]
    return len(data)
