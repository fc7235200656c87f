"""Who is logged in: sessions by the digest of their cookie, in memory only. Pure.

A cookie is 256 random bits. Only its SHA-256 is kept, so nothing that reads this process's memory
late, or its core file, has a cookie to send. A session ends 8 hours after it began, 30 minutes
after its last use, and with the process. Time is that of a clock that cannot be set: one that is
ahead for a look would end all of them. It shows, denies and revokes; it never approves.
"""

import base64
from dataclasses import dataclass
from hashlib import sha256
from typing import Final

from rossec.authority.console import owners
from rossec.errors import HttpRefused
from rossec.shares import SharedTable

COOKIE: Final = "__Host-rossec"  # the prefix: only this host, over a secure connection, sets it
COOKIE_SIZE: Final = 32  # bytes
MAX_SESSIONS: Final = 64
_TEXT_SIZE: Final = 43  # of 32 bytes as base64url


@dataclass
class Session:
    """A login. `phone`: the passkey's name; empty: by a code, to look.

    `passkey` is its credential id, as soon as that is known (`known_phones`). `seen` is the number
    of the last log entry that it was shown; None: none yet.
    """

    id: bytes
    phone: str
    began: float
    used: float
    seen: int | None = None
    passkey: bytes = b""


class Sessions:
    """The sessions of one console; the oldest of the phone with most, or to look, makes room.

    Args:
        lifetime, idle: in seconds.
    """

    def __init__(self, lifetime: int, idle: int) -> None:
        self._lifetime, self._idle = lifetime, idle
        self._sessions: SharedTable[bytes, Session] = SharedTable(MAX_SESSIONS)

    def __len__(self) -> int:
        return len(self._sessions)

    def begin(self, secret: bytes, phone: str, now: float) -> str:
        """Begin a session with `secret`, 32 random bytes; returns the value of its cookie.

        Raises:
            HttpRefused: phones have all places, and this is a session to look.
        """
        digest = sha256(secret).digest()
        owner = owners.of_phone(phone) if phone else owners.LOOKER
        if (
            self._sessions.add(digest, Session(digest, phone, now, now), owner, owners.rank(owner))
            is None
        ):
            raise HttpRefused(
                "too many are logged in", "log out elsewhere, or use a phone", status=429
            )
        return base64.urlsafe_b64encode(secret).rstrip(b"=").decode()

    def find(self, cookie: str, now: float) -> Session | None:
        """The session of a cookie's value; None: there is none, or it is over."""
        if len(cookie) != _TEXT_SIZE or not cookie.isascii():
            return None
        try:
            secret = base64.b64decode(cookie + "=", altchars=b"-_", validate=True)
        except ValueError:
            return None
        # Looked up by digest: the time it takes says nothing about the cookies there are.
        session = self._sessions.get(sha256(secret).digest())
        return session if session is not None and self.is_valid(session, now) else None

    def is_valid(self, session: Session, now: float) -> bool:
        """Whether a session still counts; one whose time is over is forgotten."""
        if self._sessions.get(session.id) is not session:
            return False
        since_begin, since_use = now - session.began, now - session.used
        if 0 <= since_begin < self._lifetime and 0 <= since_use < self._idle:
            return True
        self.end(session)
        return False

    def use(self, session: Session, now: float) -> None:
        """Note that a person used it."""
        session.used = now

    def end(self, session: Session) -> None:
        """End a session at once."""
        self._sessions.pop(session.id)

    def end_of_phone(self, phone: str) -> None:
        """End every session that the passkey of this name began."""
        for session in [each for _, each in self._sessions.items() if each.phone == phone]:
            self.end(session)


def owner_of(session: Session) -> str:
    """Who has what a session begins: the phone, with all its sessions, or one session to look."""
    return owners.of_phone(session.phone) if session.phone else owners.of_looker(session.id)
