"""The key while it is unlocked: for how long, and how often a passphrase may be tried.

Time is that of a clock that counts the seconds in which the machine sleeps (`rossec.clock.counter`)
and which cannot be set. It is checked at every signature; the key is dropped as soon as somebody
looks (`drop_if_over`). Each wrong passphrase in a row doubles the time until the next may be tried.
Threads share it: joins and the policy are signed for in another one than commands are.
"""

import math
import threading
from collections.abc import Callable
from typing import Final

from ca.errors import KeyRefused
from ca.keys.hsm import TokenSigner
from ca.keys.signer import Signer
from rossec import clock
from rossec.errors import AuthorityLocked, KeyServiceRefused

UNLOCK_HINT: Final = "unlock it with: rossec ca unlock --for 15m"
MAX_DELAY: Final = 64.0  # seconds
_MAX_DOUBLINGS: Final = 6


class HeldKey:
    """Holds the key, or does not.

    Args:
        load: the key that a passphrase or PIN opens. Raises `KeyRefused`.
        elapsed: seconds of a clock that counts sleep.
    """

    def __init__(self, load: Callable[[str], Signer], elapsed: clock.Seconds | None = None) -> None:
        self._load = load
        self._elapsed = clock.counter() if elapsed is None else elapsed
        self._held = threading.RLock()  # guards what follows
        self._signer: Signer | None = None
        self._until: float | None = None
        self._attempt = threading.Lock()  # held while a passphrase is tried
        self._failures = 0
        self._next_attempt = 0.0

    def unlock(self, passphrase: str, seconds: int) -> None:
        """Hold the key for so many seconds, 0: until it is locked; takes a tenth of a second.

        Raises:
            KeyServiceRefused: too soon after a wrong passphrase, or another attempt is under way.
            KeyRefused: the passphrase or PIN is wrong, or the key cannot be used.
        """
        if not self._attempt.acquire(blocking=False):
            raise KeyServiceRefused("another passphrase is being tried", "try again")
        try:
            signer = self._try(passphrase)
        finally:
            self._attempt.release()
        with self._held:
            self.lock()
            self._signer = signer
            self._until = self._elapsed() + seconds if seconds else None

    def _try(self, passphrase: str) -> Signer:
        wait = self._next_attempt - self._elapsed()
        if wait > 0:
            raise KeyServiceRefused(
                f"the last passphrase was wrong; the next may be tried in {wait:.0f} s",
                "wait, then try again",
            )
        with self._held:  # a token checks the PIN only where no session is open in this process
            if isinstance(self._signer, TokenSigner):
                self.lock()
        try:
            signer = self._load(passphrase)
        except KeyRefused:
            delay = min(MAX_DELAY, 2.0 ** min(self._failures, _MAX_DOUBLINGS))
            self._failures += 1
            self._next_attempt = self._elapsed() + delay
            raise
        self._failures = 0
        return signer

    def lock(self) -> bool:
        """Drop the key; whether it was held."""
        with self._held:
            signer, self._signer, self._until = self._signer, None, None
            if isinstance(signer, TokenSigner):
                signer.close()
            return signer is not None

    def drop_if_over(self) -> bool:
        """Drop the key if its time is over; whether that was so just now."""
        with self._held:
            is_over = self._until is not None and self._elapsed() >= self._until
            return is_over and self.lock()

    def remaining(self) -> int | None:
        """For how many more seconds it is held; 0: until it is locked; None: it is not held."""
        with self._held:
            if self._signer is None:
                return None
            if self._until is None:
                return 0
            left = self._until - self._elapsed()
            return None if left <= 0 else math.ceil(left)

    def check(self) -> None:
        """Raise unless it is held.

        Raises:
            AuthorityLocked: it is not, or not any more.
        """
        if self.remaining() is None:
            raise _locked()

    def sign(self, message: bytes) -> bytes:
        """As `Signer.sign`.

        Raises:
            AuthorityLocked: the key is not held, or not any more.
            TokenRefused: the token refuses.
        """
        with self._held:
            if self.remaining() is None or self._signer is None:
                raise _locked()
            return self._signer.sign(message)


def _locked() -> AuthorityLocked:
    return AuthorityLocked("the authority is locked", UNLOCK_HINT)
