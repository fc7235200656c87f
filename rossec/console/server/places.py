"""The places of the console's connections: shares by source, then by who is logged in. Pure.

A connection takes a place when it is accepted, before TLS begins, and keeps it until it is closed.
Where all are taken, one of the source that has most makes room (`rossec.net.halfopen`). One on
which a session was shown moves to the places of sessions: strangers end none of those.
"""

from collections.abc import Callable
from typing import Final

from rossec.net.halfopen import HalfOpen, HalfOpenCount, HalfOpenSlot

STRANGERS: Final = HalfOpen(per_address=64, total=256)  # a browser has six, and a page one for news
SESSIONS: Final = HalfOpen(per_address=32, total=128)  # of one phone, or of one session to look
OTHER_USERS: Final = HalfOpen(per_address=8, total=8)  # of this host; they are told, and no more
PROXIES: Final = HalfOpen(per_address=256, total=256)  # at a unix socket, where all have no address


class Place:
    """The place of one connection."""

    def __init__(self, slot: HalfOpenSlot, sessions: HalfOpenCount) -> None:
        self._slot = slot
        self._sessions = sessions
        self._owner = ""

    def closed_by(self, close: Callable[[], None]) -> None:
        """How to close the connection, to make room."""
        self._slot.close = close

    def belongs_to(self, owner: str) -> None:
        """A session of `owner` was shown on it: it counts among those, if they have room."""
        if owner == self._owner:
            return
        slot = self._sessions.admit(owner)
        if slot is not None:
            slot.close = self._slot.close
            self._slot.release()
            self._slot, self._owner = slot, owner

    def release(self) -> None:
        """The connection is closed."""
        self._slot.release()


class ConnectionShares:
    """All places of one console."""

    def __init__(self) -> None:
        self._strangers = HalfOpenCount(STRANGERS)
        self._sessions = HalfOpenCount(SESSIONS)
        self._other_users = HalfOpenCount(OTHER_USERS)
        self._proxies = HalfOpenCount(PROXIES)

    def __len__(self) -> int:
        """How many are taken."""
        counts = (self._strangers, self._sessions, self._other_users, self._proxies)
        return sum(map(len, counts))

    def take(self, address: str, *, is_other_user: bool) -> Place | None:
        """A place for a connection from `address` (empty: of a proxy); None: there is no room."""
        if is_other_user:
            count = self._other_users
        else:
            count = self._strangers if address else self._proxies
        slot = count.admit(address)
        return None if slot is None else Place(slot, self._sessions)
