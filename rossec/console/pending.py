"""Acts that are shown to a phone and not approved yet: the console's side of a statement. Pure.

The statement itself is the service's. Here is what the page said it was for, so that the answer
leads on to the right page, and only in the session that asked.
"""

from typing import Final, NamedTuple

from rossec.authority.console import owners
from rossec.console.approving import Act
from rossec.errors import HttpRefused
from rossec.shares import SharedTable

MAX_PENDING: Final = 256


class _Pending(NamedTuple):
    session: bytes
    act: Act


class PendingActs:
    """The acts that wait for a passkey, by the statement's id."""

    def __init__(self) -> None:
        self._acts: SharedTable[bytes, _Pending] = SharedTable(MAX_PENDING)

    def add(self, statement: bytes, session: bytes, act: Act, owner: str = "") -> None:
        """Keep an act of a session until it is approved; the oldest of who has most makes room.

        Raises:
            HttpRefused: all places are of phones, or of others who have no more than one.
        """
        who = owner or owners.of_looker(session)
        if self._acts.add(statement, _Pending(session, act), who, owners.rank(who)) is None:
            raise HttpRefused("too much waits for a phone", "approve that, or wait", status=429)

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
        self._acts.pop(statement)
