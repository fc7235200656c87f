"""Who is logged in, and how often somebody may try: in memory only, and by a clock that cannot be set. Pure.

A cookie is 256 random bits. A session ends 8 hours after it began, 30 minutes after its last use, and with
the process. It shows, denies and revokes; it never approves.
"""

import base64
from collections import Counter, deque
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from hashlib import sha256
from typing import Final, Generic, TypeVar

from ca.approvals.passkeys import base64url
from ca.bounded import Newest
from rossec import clock
from rossec.authority.console import messages
from rossec.errors import HttpRefused
from rossec.net.limits import source_of
from rossec.peer_limits import SharedTable

_V = TypeVar("_V")
COOKIE: Final = "__Host-rossec"  # the prefix: only this host, over a secure connection, sets it
COOKIE_SIZE: Final = 32  # bytes
MAX_SESSIONS: Final = 64
KEPT: Final = 2.0  # seconds for which an answer about phones is taken
MAX_FAILURES: Final = 5
WINDOW: Final = 60  # seconds
MAX_ADDRESSES: Final = 256
MAX_WAITING: Final = 4
_TEXT_SIZE: Final = 43  # of 32 bytes as base64url


@dataclass
class LoginSession:
    id: bytes
    phone: str  # the passkey's name; empty: by a code, to look
    began: float
    used: float
    seen: int | None = None  # the number of the last log entry that it was shown; None: none yet
    passkey: bytes = b""  # its credential id, as soon as that is known (`KnownPhones`)


class Sessions:
    """The sessions of one console; the oldest of the phone with most, or to look, makes room."""

    def __init__(self, lifetime: int, idle: int) -> None:
        self._lifetime, self._idle = lifetime, idle
        # In shares: whoever may only look ends no session of a phone by beginning many (looker-floods).
        self._sessions: SharedTable[bytes, LoginSession] = SharedTable(MAX_SESSIONS)

    def __len__(self) -> int:
        return len(self._sessions)

    def begin(self, secret: bytes, phone: str, now: float) -> str:
        # Returns the value of its cookie. Only the digest of the secret is kept: whoever reads this process's
        # memory late, or its core file, has no cookie to send.
        session = LoginSession(sha256(secret).digest(), phone, now, now)
        owner = messages.of_phone(phone) if phone else messages.LOOKER
        if self._sessions.add(session.id, session, owner, messages.rank(owner)) is None:
            raise HttpRefused("too many are logged in", "log out elsewhere, or use a phone", status=429)
        return base64url(secret)

    def find(self, cookie: str, now: float) -> LoginSession | None:
        if len(cookie) != _TEXT_SIZE or not cookie.isascii():
            return None
        try:
            secret = base64.b64decode(cookie + "=", altchars=b"-_", validate=True)
        except ValueError:
            return None
        # Looked up by digest: the time it takes says nothing about the cookies there are.
        session = self._sessions.get(sha256(secret).digest())
        return session if session is not None and self.is_valid(session, now) else None

    def is_valid(self, session: LoginSession, now: float) -> bool:
        if self._sessions.get(session.id) is not session:
            return False
        since_begin, since_use = now - session.began, now - session.used
        if 0 <= since_begin < self._lifetime and 0 <= since_use < self._idle:
            return True
        self.end(session)
        return False

    def end(self, session: LoginSession) -> None:
        self._sessions.pop(session.id)

    def end_of_phone(self, phone: str) -> None:
        for session in [each for _, each in self._sessions.items() if each.phone == phone]:
            self.end(session)


def owner_of(session: LoginSession) -> str:
    """Who has what a session begins: the phone, with all its sessions, or one session to look."""
    return messages.of_phone(session.phone) if session.phone else messages.of_looker(session.id)


class SessionTable(Generic[_V]):
    """What was begun in a session, by a key: no other session finds it; owners have shares."""

    def __init__(self, limit: int) -> None:
        self._table: SharedTable[bytes, tuple[bytes, _V]] = SharedTable(limit)

    def add(self, key: bytes, session: bytes, value: _V, owner: str) -> bool:
        return self._table.add(key, (session, value), owner, messages.rank(owner)) is not None

    def get(self, key: bytes, session: bytes) -> _V | None:
        found = self._table.get(key)
        return None if found is None or found[0] != session else found[1]

    def pop(self, key: bytes, session: bytes) -> _V | None:
        found = self.get(key, session)
        if found is not None:
            self._table.pop(key)
        return found


Phones = Callable[[], Awaitable[tuple[messages.PhoneView, ...]]]


class KnownPhones:
    """The phones of the record, as asked for last: a session outlives its phone by at most `KEPT`."""

    def __init__(self, phones: Phones, elapsed: clock.Seconds | None = None) -> None:
        self._phones = phones
        self._elapsed = clock.counter() if elapsed is None else elapsed
        self._asked = float("-inf")
        self._known: tuple[messages.PhoneView, ...] = ()

    async def counts(self, session: LoginSession) -> bool:
        is_fresh = self._elapsed() - self._asked < KEPT
        if not session.phone or (is_fresh and self._is_known(session)):
            return True
        asked = self._elapsed()
        # Where the service does not answer nobody is let in: whoever was removed could be among them.
        self._known = await self._phones()  # also for a phone that was set up just now
        self._asked = asked
        return self._is_known(session)

    def _is_known(self, session: LoginSession) -> bool:
        for each in self._known:
            if each.name == session.phone and not each.ended:  # one at most
                # By the passkey, not the name: a phone that is registered again under the name of one that
                # was removed does not bring its sessions back.
                session.passkey = session.passkey or each.id
                return session.passkey == each.id
        return False


class FailureLimit:
    """How often somebody may be wrong: five times a minute, then a minute's pause."""

    # Codes have 128 bits and passkeys cannot be guessed: this keeps noise from the authority, and makes
    # whoever mistypes look again. Counted by address, so that one device does not lock out another; of IPv6
    # by the network, since a device has as many addresses as it likes.

    def __init__(self) -> None:
        self._failures: Newest[str, deque[float]] = Newest(MAX_ADDRESSES)

    def is_blocked(self, address: str, now: float) -> bool:
        if not address:  # behind a proxy all have none: one would keep out everybody
            return False
        times = self._failures.get(source_of(address))
        return times is not None and sum(now - time < WINDOW for time in times) >= MAX_FAILURES

    def note(self, address: str, now: float) -> None:
        key = source_of(address)
        self._failures[key] = deque((*self._failures.get(key, ()), now), maxlen=MAX_FAILURES)


class LoginTurns:
    """How many questions of one source wait for the authority's service before a login."""

    # Anybody on the network may ask for a challenge, and all such questions take turns at the service. A
    # source that has several waiting is told to come back, so a phone waits for few of each.

    def __init__(self) -> None:
        self._waiting: Counter[str] = Counter()

    @contextmanager
    def wait(self, address: str) -> Iterator[None]:
        source = source_of(address)
        if address and self._waiting[source] >= MAX_WAITING:
            raise HttpRefused("too many attempts", "wait a minute", status=429)
        self._waiting[source] += 1
        try:
            yield
        finally:
            self._waiting[source] -= 1
            if not self._waiting[source]:
                del self._waiting[source]
