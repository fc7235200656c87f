"""Acts that are shown to a phone and not approved yet: the console's side of a statement. Pure.

The statement itself is the service's. Here is what the page said it was for, so that the answer
leads on to the right page, and only in the session that asked.
"""

from collections import OrderedDict
from typing import Final, NamedTuple

from rossec.console.approving import Act
from rossec.errors import HttpRefused

MAX_PENDING: Final = 256


class _Pending(NamedTuple):
    session: bytes
    act: Act


class PendingActs:
    """The acts that wait for a passkey, by the statement's id; the oldest makes room."""

    def __init__(self) -> None:
        self._acts: OrderedDict[bytes, _Pending] = OrderedDict()

    def add(self, statement: bytes, session: bytes, act: Act) -> None:
        """Keep an act of a session until it is approved."""
        while len(self._acts) >= MAX_PENDING:
            self._acts.popitem(last=False)
        self._acts[statement] = _Pending(session, act)

    def get(self, statement: bytes, session: bytes) -> Act:
        """The act of a statement.

        Raises:
            HttpRefused: there is none in this session.
        """
        found = self._acts.get(statement)
        if found is None or found.session != session:
            raise HttpRefused("this was not asked here", "load the page again", status=404)
        return found.act

    def remove(self, statement: bytes) -> None:
        """Forget an act: it was approved."""
        self._acts.pop(statement, None)
