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
from rossec.authority.console.acts import Arguments

MAX_STATEMENTS: Final = 64
MAX_OF_KIND: Final = 16
_HINT: Final = "look at the page again, and approve that"


class PreparedStatement(NamedTuple):
    """A statement that was shown, its payload, and the arguments it was made from."""

    statement: Statement
    payload: bytes
    arguments: Arguments


class Statements:
    """The statements that can be approved; threads may share it."""

    def __init__(self, elapsed: clock.Seconds | None = None) -> None:
        self._elapsed = clock.counter() if elapsed is None else elapsed
        self._lock = threading.Lock()
        self._shown: dict[bytes, tuple[PreparedStatement, float]] = {}

    def add(self, shown: PreparedStatement) -> None:
        """Keep a statement. Where there are too many, the oldest of its kind is dropped."""
        with self._lock:
            self._drop_old()
            for limit, kind in ((MAX_OF_KIND, shown.statement.kind), (MAX_STATEMENTS, None)):
                self._make_room(limit, kind)
            self._shown[shown.statement.id] = shown, self._elapsed() + LIFETIME

    def take(self, number: bytes, now: int) -> PreparedStatement:
        """The statement with this id, which is used up by this.

        Raises:
            ApprovalOutdated: it was not made here, was used, or its time is over.
        """
        with self._lock:
            self._drop_old()
            found = self._shown.pop(number, None)
        if found is None:
            raise ApprovalOutdated("this is not waiting for a touch, or not any more", _HINT)
        statement = found[0].statement
        if not statement.made <= now <= statement.until:
            raise ApprovalOutdated("the touch came too late, or the clock was set", _HINT)
        return found[0]

    def _make_room(self, limit: int, kind: Kind | None) -> None:
        of_kind = [
            number
            for number, (shown, _) in self._shown.items()
            if kind is None or shown.statement.kind is kind
        ]
        for number in of_kind[: max(0, len(of_kind) - limit + 1)]:
            del self._shown[number]

    def _drop_old(self) -> None:
        now = self._elapsed()
        self._shown = {number: item for number, item in self._shown.items() if now < item[1]}
