"""One-time codes: what a person reads at the terminal, or at a phone that is there already.

Only their SHA-256 is kept, in memory, and compared in constant time. A code is used once, for one
purpose, within `LIFETIME`. A code has 128 bits, so nobody guesses one: after `MAX_FAILURES` wrong
ones within a minute those who send more are told to wait, but a right one is always taken. Else any
stranger on the network could keep people out by being wrong. Time is that of a clock that cannot be
set.
"""

import base64
import hashlib
import hmac
import secrets
import threading
from collections import deque
from collections.abc import Callable
from enum import StrEnum
from typing import Final, NamedTuple

from rossec import clock
from rossec.authority.console import owners
from rossec.errors import KeyServiceRefused, PhoneCodeRefused
from rossec.shares import SharedTable

LIFETIME: Final = 120.0  # seconds
MAX_FAILURES: Final = 5
PERIOD: Final = 60.0  # seconds in which failures count, and for which they lock
MAX_CODES: Final = 16  # outstanding, of one use
_SIZE: Final = 16  # bytes


class CodeUse(StrEnum):
    """What a code is for."""

    TERMINAL = "terminal"  # to look, or to add a passkey
    PHONE = "phone"  # to propose a passkey


class _Code(NamedTuple):
    digest: bytes
    end: float
    owner: str


class Codes:
    """The codes that were made and not used yet; threads may share it."""

    def __init__(
        self,
        elapsed: clock.Seconds | None = None,
        random: Callable[[int], bytes] = secrets.token_bytes,
    ) -> None:
        self._elapsed = clock.counter() if elapsed is None else elapsed
        self._random = random
        self._lock = threading.Lock()  # guards what follows
        self._codes: dict[CodeUse, SharedTable[bytes, _Code]] = {
            use: SharedTable(MAX_CODES) for use in CodeUse
        }
        self._failures: deque[float] = deque(maxlen=MAX_FAILURES)
        self._locked_until = float("-inf")

    def make(self, use: CodeUse, owner: str = "") -> str:
        """A new code, base64url; the oldest of the owner who has most makes room.

        Raises:
            KeyServiceRefused: others have all of them, and none more than one.
        """
        text = base64.urlsafe_b64encode(self._random(_SIZE)).rstrip(b"=").decode()
        code = _Code(_digest(text), self._elapsed() + LIFETIME, owner)
        with self._lock:
            self._drop_old()
            if self._codes[use].add(code.digest, code, owner, owners.rank(owner)) is None:
                raise KeyServiceRefused(f"{MAX_CODES} codes were made already", "use them, or wait")
        return text

    def owner(self, text: str) -> str:
        """For whom a code for a phone was made; empty: it is none."""
        with self._lock:
            found = self._codes[CodeUse.PHONE].get(_digest(text))
        return "" if found is None else found.owner

    def check(self, text: str, use: CodeUse) -> None:
        """Return if `text` is a code for this use; it stays one.

        Raises:
            PhoneCodeRefused: it is not, not any more, or too many were wrong.
        """
        with self._lock:
            self._find(text, use)

    def use(self, text: str, use: CodeUse) -> None:
        """As `check`, and it is used up."""
        with self._lock:
            self._codes[use].pop(self._find(text, use).digest)

    def _drop_old(self) -> None:
        now = self._elapsed()
        for table in self._codes.values():
            for digest, code in table.items():
                if now >= code.end:
                    table.pop(digest)

    def _find(self, text: str, use: CodeUse) -> _Code:
        now, given = self._elapsed(), _digest(text)
        known = [code for _, code in self._codes[use].items()]
        found = [code for code in known if hmac.compare_digest(code.digest, given)]
        if found and now < found[0].end:
            return found[0]
        if now < self._locked_until:
            raise PhoneCodeRefused(
                "too many codes were wrong", f"wait {self._locked_until - now:.0f} seconds"
            )
        self._failures.append(now)
        if len(self._failures) == MAX_FAILURES and now - self._failures[0] < PERIOD:
            self._locked_until = now + PERIOD
            self._failures.clear()
        raise PhoneCodeRefused(
            "this code is not valid, or not any more", "make a new one: rossec console phone"
        )


def _digest(text: str) -> bytes:
    return hashlib.sha256(text.encode(errors="surrogatepass")).digest()
