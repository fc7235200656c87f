"""Which session may still see the join code that it made: once. Pure."""

from collections import OrderedDict
from typing import Final

MAX_CODES: Final = 64


class MadeCodes:
    """Approvals of join codes, by their id, that were not shown yet; the oldest makes room."""

    def __init__(self) -> None:
        self._sessions: OrderedDict[bytes, bytes] = OrderedDict()

    def add(self, approval: bytes, session: bytes) -> None:
        """Let `session` see what came of an approval."""
        while len(self._sessions) >= MAX_CODES:
            self._sessions.popitem(last=False)
        self._sessions[approval] = session

    def take(self, approval: bytes, session: bytes) -> bool:
        """Whether this session may see it, now and not again."""
        if self._sessions.get(approval) != session:
            return False
        del self._sessions[approval]
        return True
