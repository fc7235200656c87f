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
from rossec.master.state import journals, parameters

_log = logging.getLogger("rossec.master.saved_state")
_journal_log = logging.getLogger("rossec.master.process_memory")

REWRITE_FACTOR: Final = 4  # a journal is compacted when it is this many times as long as needed
REWRITE_MIN: Final = 1024 * 1024  # and at least this long
_APPEND: Final = os.O_WRONLY | os.O_APPEND | os.O_CLOEXEC | os.O_NOFOLLOW

Write = Callable[[bytes], None]
T = TypeVar("T")


class ListFile:
    """Saves lists and the entries of trees in `home`, later if not possible now."""

    # A list is made durable before it takes effect; but a revocation must not wait for room on a disk that
    # the revoked node may have filled. So a list that cannot be saved is in force all the same. A master that
    # is restarted before has the older list: nodes that hold the newer one refuse its timestamps, and
    # authorize nothing.
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


class JournalFile:
    """A journal on the disk: records are appended, and the whole is replaced when it has grown too long."""

    # The one mechanism of both journals; what is synced when, and what a failure means, differs.
    def __init__(self, path: Path) -> None:
        self.path = path
        self.file: int | None = None  # None: not open
        self.size = self.snapshot_size = 0  # of the file, and of the shortest one when it was replaced last

    def read(self, decode: Callable[[bytes], tuple[list[T], int]]) -> list[T]:
        data = b""
        if self.path.exists():
            with os.fdopen(ownership.open_trusted(self.path), "rb") as file:
                data = file.read()
        changes, valid = decode(data)
        if valid < len(data):  # a power failure within a record; kept aside, as it may be something else
            _journal_log.warning("%s: the last %d bytes are damaged", self.path.name, len(data) - valid)
            files.replace(self.path.with_suffix(".damaged"), data)
        return changes

    def append(self, records: bytes, *, synced: bool = False) -> str:
        # Why they were not written; empty: they were.
        file, reason = self.file, "the disk is full"
        if file is None:
            return "it is not open"
        try:
            written = os.write(file, records)
            if written == len(records):
                if synced:
                    os.fdatasync(file)
                self.size += written
                return ""
        except OSError as error:
            reason = str(error)
        os.ftruncate(file, self.size)  # half a record would end the journal
        return reason

    def is_long(self) -> bool:
        return self.size > max(REWRITE_MIN, REWRITE_FACTOR * self.snapshot_size)

    def replace(self, data: bytes) -> None:
        files.replace(self.path, data)
        self.close()  # of the old file: what is appended there would be lost
        self.take(os.open(self.path, _APPEND), len(data))

    def take(self, file: int, size: int) -> None:
        self.file, self.size, self.snapshot_size = file, size, size

    def close(self) -> None:
        if self.file is not None:
            os.close(self.file)
            self.file = None


class DepositFile:
    """The journal of deposited grants."""

    # A deposit is synced before it is acknowledged: the authority's operator is told that the master has it,
    # and may switch off his machine. That a holder has presented a grant is written in the next maintenance
    # round; if it is lost, the node presents it again.
    def __init__(self, path: Path, verify: VerifyDeposit) -> None:
        self.deposits = Deposits(verify, self._append)
        self._journal = JournalFile(path)

    def open(self) -> None:
        self.deposits.restore(self._journal.read(journals.decode_deposits))
        self._rewrite()

    def sync(self) -> None:
        # Write what was presented since; compact the file when it has grown too long.
        unsaved, journal = self.deposits.unsaved, self._journal
        if journal.file is None or not (unsaved or journal.is_long()):
            return
        try:
            if journal.is_long():
                self._rewrite()
            else:
                self._append(unsaved)
        except (NotWritten, OSError) as error:
            _journal_log.warning("%s is not up to date: %s", journal.path.name, error)
            return
        unsaved.clear()

    def close(self) -> None:
        self.sync()
        self._journal.close()

    def _append(self, changes: Sequence[journals.DepositChange]) -> None:
        journal = self._journal
        if journal.file is None:
            raise NotWritten(f"{journal.path} is not open", "restart the master")
        records = b"".join(map(journals.encode_deposit, changes))
        if reason := journal.append(records, synced=True):
            raise NotWritten(f"{journal.path.name} was not written: {reason}", "make room on the disk")

    def _rewrite(self) -> None:
        records = map(journals.encode_deposit, self.deposits.changes())
        self._journal.replace(journals.DEPOSITS_MAGIC + b"".join(records))


GROWN: Final = 64 * 1024 * 1024  # bytes written, after which the next round does not wait
MAX_UNSYNCED: Final = 256 * 1024 * 1024  # bytes written between two rounds
_CHUNK: Final = 1024 * 1024  # bytes that are written at a time
_IN_FORCE: Final = "they are in force, and saved as soon as there is room"


class ParameterFile:
    """The journal of parameters."""

    # Every change is written before the call is answered, so a crash of the master loses none; it is synced
    # at most ten seconds later, so a power failure may lose these. That, and compacting, is the work of a
    # thread and of many passes of the loop: a disk may take seconds.
    def __init__(self, path: Path) -> None:
        self.parameters = parameters.Parameters()
        self._journal = JournalFile(path)
        self._is_open = self._dirty = False
        self._complete = True  # False: a change is missing in the file
        self._compacted: bytearray | None = None  # what the next file gets, while it is made
        self.grown = asyncio.Event()  # so much was written that `save` is due now

    def open(self) -> None:
        journals.replay(self.parameters, self._journal.read(journals.decode_parameters))
        self._rewrite()
        self._is_open = True

    def write(self, change: journals.ParameterChange) -> None:
        # Append a change that has been made; written, not synced, on return.
        journal = self._journal
        if not self._is_open:
            return
        record = journals.encode_parameter(change)
        if self._compacted is not None:
            self._compacted += record
        self._dirty = True
        if reason := journal.append(record):  # the call succeeds all the same: it was made
            _journal_log.error("parameters cannot be saved: %s; %s", reason, _IN_FORCE)
            self._complete = False
            return
        if self._has_grown():
            self.grown.set()
        if journal.size > journal.snapshot_size + MAX_UNSYNCED:  # a caller that sets without end
            self.sync()

    def sync(self) -> None:
        file = self._journal.file
        if not (self._is_open and self._dirty):
            return
        self._dirty = False
        try:
            if file is None or self._is_long():
                self._rewrite()
            else:
                os.fdatasync(file)
        except (NotWritten, OSError) as error:
            self._not_saved(error)

    async def save(self) -> None:
        """As `sync`, beside the loop."""
        self.grown.clear()
        file = self._journal.file
        if not (self._is_open and self._dirty):
            return
        self._dirty = False
        try:
            if file is None or self._is_long():
                await self._compact()
            else:
                descriptor = os.dup(file)  # the file may be closed meanwhile
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
        return self._journal.size > self._journal.snapshot_size + GROWN

    def _is_long(self) -> bool:
        return self._journal.is_long() or self._has_grown() or not self._complete

    async def _compact(self) -> None:
        # 1. Make the new file beside the old one, which is in its place and written until that is whole.
        path = self._journal.path
        temporary = path.with_name(f".{path.name}.{secrets.token_hex(8)}")
        made = os.open(temporary, _APPEND | os.O_CREAT | os.O_EXCL, 0o600)
        waiting, size = bytearray(), 0
        self._compacted = waiting
        try:
            # 2. The parameters piece by piece; a change between two pieces follows those made before it.
            for piece in journals.pieces(self.parameters):
                waiting += piece
                await asyncio.sleep(0)
                if len(waiting) >= _CHUNK:
                    size += await _move(waiting, made)
            while len(waiting) >= _CHUNK:
                size += await _move(waiting, made)
            await _in_thread(lambda: os.fdatasync(made))
            # 3. The rest and the exchange in one pass of the loop: no change can come between.
            size += _write_all(made, bytes(waiting))
            if not self._is_open:
                raise NotWritten(f"{path.name} was closed meanwhile", "start the master again")
            temporary.replace(path)
        except BaseException:
            os.close(made)
            temporary.unlink(missing_ok=True)
            raise
        finally:
            self._compacted = None
        self._journal.close()
        self._journal.take(made, size)
        self._complete = True
        await _in_thread(lambda: files.sync_directory(path.parent))

    def close(self) -> None:
        self.sync()
        self._is_open = False
        self._journal.close()

    def _rewrite(self) -> None:
        self._journal.replace(journals.snapshot(self.parameters))
        self._complete = True


async def _move(waiting: bytearray, descriptor: int) -> int:
    data = bytes(waiting)
    waiting.clear()
    await _in_thread(lambda: _write_all(descriptor, data))
    return len(data)


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
