"""Statements that were shown and wait for a touch: in memory, few, each used once.

A statement that this process did not make is never approved. Its time ends by the clock of the
host, which is in the statement, and by one that cannot be set: a host's clock that was stopped or
set back makes no statement last longer.
"""

import threading
from typing import Final, NamedTuple

from ca.approvals.statement import LIFETIME, Kind, Statement
from ca.errors import ApprovalOutdated
from rossec import clock
from rossec.authority.console import owners
from rossec.authority.console.acts import Arguments
from rossec.errors import KeyServiceRefused
from rossec.shares import SharedTable

MAX_OF_KIND: Final = 16
_HINT: Final = "look at the page again, and approve that"


class PreparedStatement(NamedTuple):
    """A statement that was shown, its payload, and the arguments it was made from."""

    statement: Statement
    payload: bytes
    arguments: Arguments


class _Shown(NamedTuple):
    prepared: PreparedStatement
    end: float


class Statements:
    """The statements that can be approved; threads may share it."""

    def __init__(self, elapsed: clock.Seconds | None = None) -> None:
        self._elapsed = clock.counter() if elapsed is None else elapsed
        self._lock = threading.Lock()
        self._shown: dict[Kind, SharedTable[bytes, _Shown]] = {
            kind: SharedTable(MAX_OF_KIND) for kind in Kind
        }

    def add(self, shown: PreparedStatement, owner: str = "") -> None:
        """Keep a statement of `owner`.

        Where there are too many of its kind, the oldest of whoever has most makes room, and none of
        a phone for one of a session that may only look.

        Raises:
            KeyServiceRefused: there is no room for this owner.
        """
        statement = shown.statement
        kept = _Shown(shown, self._elapsed() + LIFETIME)
        with self._lock:
            self._drop_old()
            table = self._shown[statement.kind]
            if table.add(statement.id, kept, owner, owners.rank(owner)) is None:
                raise KeyServiceRefused(
                    f"{MAX_OF_KIND} such approvals wait for a touch", "approve them, or wait"
                )

    def take(self, number: bytes, now: int) -> PreparedStatement:
        """The statement with this id, which is used up by this.

        Raises:
            ApprovalOutdated: it was not made here, was used, or its time is over.
        """
        with self._lock:
            self._drop_old()
            taken = [table.pop(number) for table in self._shown.values()]
        found = next(filter(None, taken), None)
        if found is None:
            raise ApprovalOutdated("this is not waiting for a touch, or not any more", _HINT)
        statement = found.prepared.statement
        if not statement.made <= now <= statement.until:
            raise ApprovalOutdated("the touch came too late, or the clock was set", _HINT)
        return found.prepared

    def _drop_old(self) -> None:
        now = self._elapsed()
        for table in self._shown.values():
            for number, shown in table.items():
                if now >= shown.end:
                    table.pop(number)
