"""What the service does for those who ask: the operations of `messages`, and its own signatures.

Everything is audited with who asked, a signature *before* it is made: where the audit cannot be
written, nothing is signed. `unlock` takes a tenth of a second and may be called in a thread; the
others return at once.
"""

import hashlib
from collections.abc import Callable
from typing import Final

from cryptography.hazmat.primitives.asymmetric import ec

from ca.encoding import Value
from ca.errors import HintedError, KeyRefused
from rossec.authority.keyservice import messages
from rossec.authority.keyservice.held_key import HeldKey
from rossec.authority.keyservice.messages import MAX_PASSPHRASE, MAX_UNLOCKED, Request
from rossec.authority.keyservice.recognize import Authority, kind_of
from rossec.errors import KeyServiceRefused, SigningRefused

ITSELF: Final = "the service itself"


class KeyOperations:
    """Signs, locks and unlocks.

    Args:
        held: the key.
        authority: whose key it is.
        audit: writes a line. Raises `HintedError` if it cannot.
        describe: what `status` says besides whether the key is held.
    """

    def __init__(
        self,
        held: HeldKey,
        authority: Authority,
        audit: Callable[[str], None],
        describe: Callable[[], dict[int | str, Value]] = dict,
    ) -> None:
        self.held = held
        self._authority = authority
        self._audit = audit
        self._describe = describe
        self.on_unlock: Callable[[], None] = _nothing  # there may be work that waited for the key

    def carry_out(self, request: Request, caller: object) -> Value:
        """Carry out a request of `caller`, whose text names it in the audit.

        Raises:
            HintedError: refused; the text is for the caller.
        """
        match request:
            case Request(messages.STATUS):
                return self.status()
            case Request(messages.SIGN, (bytes() as message,)):
                return self.sign(message, caller)
            case Request(messages.UNLOCK, (int() as seconds, str() as passphrase)):
                return self.unlock(passphrase, seconds, caller)
            case _:
                return self.lock(caller)

    def status(self) -> Value:
        """Whether the key is held, and for how long; see `HeldKey.remaining`."""
        remaining = self.held.remaining()
        return {**self._describe(), "locked": remaining is None, "remaining": remaining}

    def sign(self, message: bytes, caller: object = ITSELF) -> bytes:
        """Sign a statement or a certificate.

        Raises:
            SigningRefused: nothing that an authority signs.
            AuthorityLocked: the key is not held.
            KeyServiceRefused: the audit cannot be written.
        """
        try:
            kind = kind_of(message, self._authority)
        except SigningRefused:
            self._audit(f"refused to sign {len(message)} unknown bytes for {caller}")
            raise
        self.held.check()
        self._audit(f"signs {kind}, SHA-256 {hashlib.sha256(message).hexdigest()}, for {caller}")
        return self.held.sign(message)

    def unlock(self, passphrase: str, seconds: int, caller: object) -> Value:
        """Hold the key for `seconds` from now on; returns as `status`.

        Raises:
            KeyServiceRefused: the time is out of range, or too soon after a wrong passphrase.
            KeyRefused: the passphrase is wrong.
        """
        if not 0 <= seconds <= MAX_UNLOCKED or len(passphrase) > MAX_PASSPHRASE:
            raise KeyServiceRefused(
                f"unlocking for {seconds} s where 0 to {MAX_UNLOCKED} are allowed",
                "0 unlocks for as long as the service runs",
            )
        try:
            self.held.unlock(passphrase, seconds)
        except KeyRefused as error:
            self._audit(f"failed to unlock for {caller}: {error}")
            raise
        duration = f"{seconds} s" if seconds else "as long as it runs"
        try:
            self._audit(f"unlocked for {duration} by {caller}")
        except HintedError:
            self.held.lock()
            raise
        self.on_unlock()
        return self.status()

    def audit(self, text: str) -> None:
        """Write a line about something that is not signed, or before it is.

        Raises:
            KeyServiceRefused: it cannot be written.
        """
        self._audit(text)

    def lock(self, caller: object) -> Value:
        """Drop the key at once; returns as `status`."""
        if self.held.lock():
            self._audit(f"locked by {caller}")
        return self.status()

    def lock_if_over(self) -> None:
        """Drop the key if its time is over."""
        if self.held.drop_if_over():
            self._audit("locked: its time is over")


class OwnSigner:
    """A `Signer` for what the service does itself: joins, and what the policy gives."""

    def __init__(
        self,
        operations: KeyOperations,
        public_key: ec.EllipticCurvePublicKey,
        purpose: str = ITSELF,
    ) -> None:
        self._operations = operations
        self._public_key = public_key
        self.purpose = purpose

    @property
    def public_key(self) -> ec.EllipticCurvePublicKey:
        """The public key."""
        return self._public_key

    def sign(self, message: bytes) -> bytes:
        """As `KeyOperations.sign`, for the purpose named in the audit."""
        return self._operations.sign(message, self.purpose)


def _nothing() -> None:
    """No work waits."""
