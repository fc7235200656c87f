"""The audit of approvals: replayed from the log, in the order in which they were made.

Each was by a passkey that was registered and had not ended, signs its statement, and names a head
of this log that is true, from after the record was last restored. Each end is of an approval that
waited. The rows are those of the log already (`ca.store.log`).
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import starmap
from typing import Any, Final

from ca.approvals.approval import Approval, ApprovalVerifier
from ca.approvals.assertion import Passkey
from ca.approvals.registration import to_approve
from ca.approvals.statement import Statement
from ca.errors import ApprovalRefused, LogDamaged
from ca.revocation.merkle import Tree
from ca.store.log_entries import LogEntry

RESTORED: Final = "restored"
_HINT: Final = "somebody changed the record: restore a backup, and find out who"
Row = tuple[Any, ...]


def replay_approvals(
    entries: Iterable[LogEntry], rows: Mapping[str, Iterable[Row]], tree: Tree
) -> None:
    """Check every passkey and approval; `rows` are those of the tables, by kind of entry.

    Raises:
        LogDamaged: names the first entry that could not have been made.
    """
    replay = _Replay(rows, tree)
    for entry in entries:
        step = replay.steps.get(entry.what)
        if step is not None:
            try:
                step(entry)
            except ApprovalRefused as error:
                raise LogDamaged(f"log entry {entry.number}: {error}", _HINT) from error


class _Replay:
    def __init__(self, rows: Mapping[str, Iterable[Row]], tree: Tree) -> None:
        self._tree = tree
        self._passkeys = starmap(Passkey, rows["passkey"])
        self._passkey_ends: Iterator[Row] = iter(rows["passkey ended"])
        self._approvals = starmap(Approval, rows["approval"])
        self._ends: Iterator[Row] = iter(rows["approval ended"])
        self._active: set[bytes] = set()
        self._approved: dict[bytes, Statement] = {}
        self._waiting: set[bytes] = set()
        self._restored = -1
        self._verifier = ApprovalVerifier(())
        self.steps: Mapping[str, Callable[[LogEntry], None]] = {
            RESTORED: self._restore,
            "passkey": self._add_passkey,
            "passkey ended": self._end_passkey,
            "approval": self._approve,
            "approval ended": self._end,
        }

    def _restore(self, entry: LogEntry) -> None:
        self._restored = entry.number

    def _add_passkey(self, entry: LogEntry) -> None:
        passkey = next(self._passkeys)
        if passkey.approval:
            by = self._approved.get(passkey.approval)
            _require(by is not None and by.what == to_approve(passkey), entry)
        self._active.add(passkey.id)
        self._verifier.add_passkey(passkey)

    def _end_passkey(self, entry: LogEntry) -> None:
        ended = next(self._passkey_ends)[0]
        _require(ended in self._active, entry)
        self._active.discard(ended)

    def _approve(self, entry: LogEntry) -> None:
        approval = next(self._approvals)
        _require(approval.passkey in self._active, entry)
        statement = self._verifier.verify(approval)
        _require(self._restored < statement.log_size <= entry.number, entry)
        _require(self._tree.root(statement.log_size) == statement.log_root, entry)
        self._approved[approval.id] = statement
        self._waiting.add(approval.id)

    def _end(self, entry: LogEntry) -> None:
        ended = next(self._ends)[0]
        _require(ended in self._waiting, entry)
        self._waiting.discard(ended)


def _require(holds: bool, entry: LogEntry) -> None:
    if not holds:
        raise LogDamaged(f"log entry {entry.number} says {entry.what}, which cannot be", _HINT)
