"""What the master saves: the newest lists, its parameters, the grants deposited at it. A shell.

Parameters and deposits are journals, compacted when they have grown. Registrations are not stored:
nodes register again with a restarted master, and a node that died meanwhile would stay registered.
"""

import asyncio
import logging
import os
import secrets
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final, TypeVar

from ca.errors import HintedError
from ca.keys import ownership
from rossec import files
from rossec.errors import NotWritten
from rossec.home import NodeHome
from rossec.master.rights.held_grants import Deposits, VerifyDeposit
from rossec.master.state import journals
from rossec.master.state.journals import DepositChange, ParameterChange
from rossec.master.state.parameters import Parameters

_log = logging.getLogger("rossec.master.keeping")
_journal_log = logging.getLogger("rossec.master.memory")

REWRITE_FACTOR: Final = 4  # a journal is compacted when it is this many times as long as needed
REWRITE_MIN: Final = 1024 * 1024  # and at least this long
_APPEND: Final = os.O_WRONLY | os.O_APPEND | os.O_CLOEXEC | os.O_NOFOLLOW

Write = Callable[[bytes], None]
T = TypeVar("T")


class ListFile:
    """Saves lists and the entries of trees in `home`, later if not possible now.

    A list is made durable before it takes effect; but a revocation must not wait for room on a disk
    that the revoked node may have filled. So a list that cannot be saved is in force all the same.
    A master that is restarted before has the older list: nodes that hold the newer one refuse its
    timestamps, and authorize nothing.
    """

    def __init__(self, home: NodeHome) -> None:
        self._home = home
        # By what is written, in the order in which that must be.
        self._unwritten: dict[object, tuple[Write, bytes]] = {}
        self._failing = False

    def save(self, data: bytes) -> None:
        self.save_by("revocations", self._home.save_revocations, data)

    def save_entries(self, data: bytes) -> None:
        self.save_by("entries", self._home.save_entries, data)

    def save_by(self, what: object, write: Write, data: bytes) -> None:
        self._unwritten.pop(what, None)
        self._unwritten[what] = write, data
        self.retry()

    def retry(self) -> None:
        # Write what is not written yet; called in each maintenance round.
        try:
            for what, (write, data) in tuple(self._unwritten.items()):
                write(data)
                del self._unwritten[what]
        except (NotWritten, OSError) as error:
            if not self._failing:
                hint = f" ({error.hint})" if isinstance(error, HintedError) else ""
                _log.error("a list is in force, but not saved: %s%s", error, hint)
            self._failing = True
            return
        if self._failing:
            self._failing = False
            _log.warning("the newest lists are saved now")


class DepositFile:
    """The journal of deposited grants.

    A deposit is synced before it is acknowledged: the authority's operator is told that the master
    has it, and may switch off his machine. That a holder has presented a grant is written in the
    next maintenance round; if it is lost, the node presents it again.
    """

    def __init__(self, path: Path, verify: VerifyDeposit) -> None:
        self.deposits = Deposits(verify, self._append)
        self._path = path
        self._file: int | None = None
        self._size = self._snapshot_size = 0

    def open(self) -> None:
        self.deposits.restore(_read_journal(self._path, journals.decode_deposits))
        self._rewrite()

    def sync(self) -> None:
        # Write what was presented since; compact the file when it has grown too long.
        unsaved = self.deposits.unsaved
        if self._file is None or not (unsaved or self._is_long()):
            return
        try:
            if self._is_long():
                self._rewrite()
            else:
                self._append(unsaved)
        except (NotWritten, OSError) as error:
            _journal_log.warning("%s is not up to date: %s", self._path.name, error)
            return
        unsaved.clear()

    def close(self) -> None:
        self.sync()
        if self._file is not None:
            os.close(self._file)
            self._file = None

    def _append(self, changes: Sequence[DepositChange]) -> None:
        if self._file is None:
            raise NotWritten(f"{self._path} is not open", "restart the master")
        records = b"".join(map(journals.encode_deposit, changes))
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

    def _rewrite(self) -> None:
        records = map(journals.encode_deposit, self.deposits.changes())
        data = journals.DEPOSITS_MAGIC + b"".join(records)
        files.replace(self._path, data)
        if self._file is not None:  # of the old file: what is appended there would be lost
            os.close(self._file)
            self._file = None
        self._file = os.open(self._path, _APPEND)
        self._size = self._snapshot_size = len(data)


GROWN: Final = 64 * 1024 * 1024  # bytes written, after which the next round does not wait
MAX_UNSYNCED: Final = 256 * 1024 * 1024  # bytes written between two rounds

_CHUNK: Final = 1024 * 1024  # bytes that are written at a time
_IN_FORCE: Final = "they are in force, and saved as soon as there is room"


class ParameterFile:
    """The journal of parameters.

    Every change is written before the call is answered, so a crash of the master loses none; it is
    synced at most ten seconds later, so a power failure may lose these. That, and compacting, is
    the work of a thread and of many passes of the loop: a disk may take seconds.
    """

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
        journals.replay(self.parameters, _read_journal(self._path, journals.decode_parameters))
        self._rewrite()

    def write(self, change: ParameterChange) -> None:
        # Append a change that has been made; written, not synced, on return.
        if self._file is None:
            return
        record = journals.encode_parameter(change)
        if self._compacted is not None:
            self._compacted += record
        written, reason = 0, "the disk is full"
        try:
            written = os.write(self._file, record)
        except OSError as error:  # the call succeeds all the same: the change was made
            reason = str(error)
        self._dirty = True
        if written != len(record):
            _journal_log.error("parameters cannot be saved: %s; %s", reason, _IN_FORCE)
            os.ftruncate(self._file, self._size)  # half a record would end the journal
            self._complete = False
            return
        self._size += len(record)
        if self._has_grown():
            self.grown.set()
        if self._size > self._snapshot_size + MAX_UNSYNCED:  # a caller that sets without end
            self.sync()

    def sync(self) -> None:
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
        _journal_log.error("parameters cannot be saved: %s; %s", error, _IN_FORCE)

    def _has_grown(self) -> bool:
        return self._size > self._snapshot_size + GROWN

    def _is_long(self) -> bool:
        long = self._size > max(REWRITE_MIN, REWRITE_FACTOR * self._snapshot_size)
        return long or self._has_grown() or not self._complete

    async def _compact(self) -> None:
        # They are in the old file too, which is in its place until the new one is whole.
        temporary = self._path.with_name(f".{self._path.name}.{secrets.token_hex(8)}")
        made = os.open(temporary, _APPEND | os.O_CREAT | os.O_EXCL, 0o600)
        waiting, size = bytearray(), 0
        self._compacted = waiting
        try:
            for piece in journals.pieces(self.parameters):
                waiting += piece
                await asyncio.sleep(0)
                if len(waiting) >= _CHUNK:
                    size += await self._move(waiting, made)
            while len(waiting) >= _CHUNK:
                size += await self._move(waiting, made)
            await _in_thread(lambda: os.fdatasync(made))
            size += _write_all(made, bytes(waiting))  # as each change is written
            old = self._file
            if old is None:
                raise NotWritten(f"{self._path.name} was closed meanwhile", "start the master again")
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

    @staticmethod
    async def _move(waiting: bytearray, descriptor: int) -> int:
        data = bytes(waiting)
        waiting.clear()
        await _in_thread(lambda: _write_all(descriptor, data))
        return len(data)

    def close(self) -> None:
        self.sync()
        if self._file is not None:
            os.close(self._file)
            self._file = None

    def _rewrite(self) -> None:
        data = journals.snapshot(self.parameters)
        files.replace(self._path, data)
        old = self._file
        self._file = os.open(self._path, _APPEND)
        self._size = self._snapshot_size = len(data)
        self._complete = True
        if old is not None:
            os.close(old)


def _read_journal(path: Path, decode: Callable[[bytes], tuple[list[T], int]]) -> list[T]:
    data = b""
    if path.exists():
        with os.fdopen(ownership.open_trusted(path), "rb") as file:
            data = file.read()
    changes, valid = decode(data)
    if valid < len(data):
        _journal_log.warning("%s: the last %d bytes are damaged", path.name, len(data) - valid)
        files.replace(path.with_suffix(".damaged"), data)
    return changes


async def _in_thread(work: Callable[[], object]) -> None:
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
