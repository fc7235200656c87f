"""Passkeys that a new phone proposes, until a phone that is there already approves them.

In memory: one that is not approved within `LIFETIME` is gone. Both phones show the same digits, so
the person sees that the passkey is that of the phone in the other hand. Its id is random and comes
from here, so nobody can look for a passkey whose digits are those of another.
"""

import hashlib
import secrets
import threading
from collections.abc import Callable
from typing import Final, NamedTuple

from ca.approvals.assertion import Passkey
from ca.errors import PasskeyUnknown
from rossec import clock
from rossec.authority.console import owners
from rossec.authority.console.views import Proposal
from rossec.errors import KeyServiceRefused
from rossec.shares import SharedTable

LIFETIME: Final = 300  # seconds
MAX_PROPOSALS: Final = 4
_LABEL: Final = b"rossec-proposal-v1"


class _Proposed(NamedTuple):
    passkey: Passkey
    shown: Proposal
    end: float


class Proposals:
    """The passkeys that wait; threads may share it."""

    def __init__(
        self,
        elapsed: clock.Seconds | None = None,
        random: Callable[[int], bytes] = secrets.token_bytes,
    ) -> None:
        self._elapsed = clock.counter() if elapsed is None else elapsed
        self._random = random
        self._lock = threading.Lock()
        self._proposed: SharedTable[bytes, _Proposed] = SharedTable(MAX_PROPOSALS)

    def add(self, passkey: Passkey, now: int, owner: str = "") -> Proposal:
        """Keep a passkey that was registered by a link of `owner`, and not approved.

        Where there are too many, the oldest by a link of a looker makes room for one by a phone's.

        Raises:
            KeyServiceRefused: too many wait.
        """
        rank = owners.rank(owner)
        with self._lock:
            self._drop_old()
            waiting = [self._proposed.owner(number) for number, _ in self._proposed.items()]
            if len(waiting) >= MAX_PROPOSALS and all(each and each[1] >= rank for each in waiting):
                raise KeyServiceRefused(
                    f"{MAX_PROPOSALS} phones wait to be approved", "approve them, or wait"
                )
            number = self._random(16)
            shown = Proposal(number, passkey.name, digits_of(number, passkey), now + LIFETIME)
            proposed = _Proposed(passkey, shown, self._elapsed() + LIFETIME)
            self._proposed.add(number, proposed, owner, rank)
        return shown

    def all(self) -> tuple[Proposal, ...]:
        """Those that wait, oldest first."""
        with self._lock:
            self._drop_old()
            return tuple(each.shown for _, each in self._proposed.items())

    def get(self, number: bytes) -> Passkey:
        """The passkey of one proposal, to be approved.

        Raises:
            PasskeyUnknown: there is none, or not any more.
        """
        with self._lock:
            self._drop_old()
            found = self._proposed.get(number)
        if found is None:
            raise PasskeyUnknown(
                "this phone does not wait to be approved, or not any more",
                "make a new link, and open it on that phone",
            )
        return found.passkey

    def drop(self, number: bytes) -> None:
        """Forget one: it was approved, or refused."""
        with self._lock:
            self._proposed.pop(number)

    def _drop_old(self) -> None:
        now = self._elapsed()
        for number, each in self._proposed.items():
            if now >= each.end:
                self._proposed.pop(number)


def digits_of(number: bytes, passkey: Passkey) -> str:
    """The six digits that both phones show."""
    told = b"".join((_LABEL, number, hashlib.sha256(passkey.id).digest(), passkey.cose_key))
    return f"{int.from_bytes(hashlib.sha256(told).digest()) % 1_000_000:06d}"
