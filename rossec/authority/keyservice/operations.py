"""The key while it is unlocked, and the operations on it: sign, lock, unlock.

Everything is audited with who asked, a signature *before* it is made: where the audit cannot be
written, nothing is signed. Time is that of a clock that counts the seconds in which the machine
sleeps and which cannot be set; it is checked at every signature. Threads share the key: joins and
the policy are signed for in another one than commands are.
"""

import hashlib
import math
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from ca.encoding import Value
from ca.errors import HintedError, KeyRefused
from ca.keys.private_keys import TokenSigner
from ca.keys.signing import PublicKey, Signer
from rossec import clock
from rossec.authority.keyservice import messages
from rossec.errors import AuthorityLocked, KeyServiceRefused, SigningRefused

UNLOCK_HINT: Final = "unlock it with: rossec ca unlock --for 15m"
MAX_DELAY: Final = 64.0  # seconds
_MAX_DOUBLINGS: Final = 6


class HeldKey:
    """`load`: the key that a passphrase or PIN opens. Raises `KeyRefused`. `elapsed`: seconds of a clock
    that counts sleep.
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
        """Hold the key for so many seconds, 0: until it is locked; takes a tenth of a second."""
        if not self._attempt.acquire(blocking=False):
            raise KeyServiceRefused("another passphrase is being tried", "try again")
        try:
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
                # Also with a correct one that follows: whoever may connect must not guess at full speed.
                delay = min(MAX_DELAY, 2.0 ** min(self._failures, _MAX_DOUBLINGS))
                self._failures += 1
                self._next_attempt = self._elapsed() + delay
                raise
            self._failures = 0
        finally:
            self._attempt.release()
        with self._held:
            self.lock()
            self._signer = signer
            self._until = self._elapsed() + seconds if seconds else None

    def lock(self) -> bool:
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
        if self.remaining() is None:
            raise AuthorityLocked("the authority is locked", UNLOCK_HINT)

    def sign(self, message: bytes) -> bytes:
        with self._held:
            self.check()  # at every signature: nobody else may have looked at the time
            assert self._signer is not None  # noqa: S101 - as `check` said
            return self._signer.sign(message)


ITSELF: Final = "the service itself"


@dataclass(eq=False, repr=False)
class KeyOperations:
    """`authority`: whose key it is. `audit`: writes a line; raises `HintedError` if it cannot. `describe`:
    what `status` says besides whether the key is held.
    """

    held: HeldKey
    authority: messages.ServedAuthority
    audit: Callable[[str], None]
    describe: Callable[[], dict[int | str, Value]] = dict
    on_unlock: Callable[[], None] = lambda: None  # there may be work that waited for the key

    def carry_out(self, request: messages.ServiceRequest, caller: object) -> Value:
        match request:
            case messages.ServiceRequest(messages.STATUS):
                return self.status()
            case messages.ServiceRequest(messages.SIGN, (bytes() as message,)):
                return self.sign(message, caller)
            case messages.ServiceRequest(messages.UNLOCK, (int() as seconds, str() as passphrase)):
                return self.unlock(passphrase, seconds, caller)
            case _:
                return self.lock(caller)

    def status(self) -> Value:
        remaining = self.held.remaining()
        return {**self.describe(), "locked": remaining is None, "remaining": remaining}

    def sign(self, message: bytes, caller: object = ITSELF) -> bytes:
        try:
            kind = messages.kind_of(message, self.authority)
        except SigningRefused:
            self.audit(f"refused to sign {len(message)} unknown bytes for {caller}")
            raise
        self.held.check()
        # Before the signature is made: where this cannot be written, nothing is signed.
        self.audit(f"signs {kind}, SHA-256 {hashlib.sha256(message).hexdigest()}, for {caller}")
        return self.held.sign(message)

    def unlock(self, passphrase: str, seconds: int, caller: object) -> Value:
        if not 0 <= seconds <= messages.MAX_UNLOCKED or len(passphrase) > messages.MAX_PASSPHRASE:
            raise KeyServiceRefused(
                f"unlocking for {seconds} s where 0 to {messages.MAX_UNLOCKED} are allowed",
                "0 unlocks for as long as the service runs",
            )
        try:
            self.held.unlock(passphrase, seconds)
        except KeyRefused as error:
            self.audit(f"failed to unlock for {caller}: {error}")
            raise
        duration = f"{seconds} s" if seconds else "as long as it runs"
        try:
            self.audit(f"unlocked for {duration} by {caller}")
        except HintedError:  # a key that is held without a line about it would be held in secret
            self.held.lock()
            raise
        self.on_unlock()
        return self.status()

    def lock(self, caller: object) -> Value:
        if self.held.lock():
            self.audit(f"locked by {caller}")
        return self.status()

    def lock_if_over(self) -> None:
        if self.held.drop_if_over():
            self.audit("locked: its time is over")


@dataclass(eq=False, repr=False)
class OwnSigner:
    operations: KeyOperations
    public_key: PublicKey
    purpose: str = ITSELF

    def sign(self, message: bytes) -> bytes:
        return self.operations.sign(message, self.purpose)
