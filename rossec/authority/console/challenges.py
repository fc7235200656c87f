"""Challenges of logins and new passkeys: made here, kept nowhere, and each used once.

Anybody on the network can ask for one, so none is kept until it is used: its id says what it is for
and until when, under a key of this process (HMAC-SHA-256, as the cookies of RFC 4987 3.6 and RFC
9147 5.1). Only those that a passkey has answered are remembered, until their time is over.
"""

import hmac
import secrets
import threading
from collections.abc import Callable
from typing import Final

from ca.approvals.challenges import Challenge, Purpose
from ca.encoding import decode, encode
from ca.errors import OtherChallenge
from rossec import clock

LIFETIME: Final = 300  # seconds
MAX_USED: Final = 1024  # by passkeys of this authority, within `LIFETIME`; then they wait
_MAC: Final = 32  # bytes


class Challenges:
    """The challenges of this process; threads may share it."""

    def __init__(
        self,
        elapsed: clock.Seconds | None = None,
        random: Callable[[int], bytes] = secrets.token_bytes,
    ) -> None:
        self._elapsed = clock.counter() if elapsed is None else elapsed
        self._random = random
        self._key = secrets.token_bytes(32)
        self._lock = threading.Lock()
        self._used: dict[bytes, float] = {}  # until when, by their id

    def __len__(self) -> int:
        """How many are remembered: those that were used, and are not over."""
        return len(self._used)

    def make(self, purpose: Purpose, domain: str, origin: str, rp_id: str, now: int) -> Challenge:
        """A new challenge, for the page at `origin`."""
        until, end = now + LIFETIME, int((self._elapsed() + LIFETIME) * 1000)
        said = encode([str(purpose), self._random(16), domain, origin, rp_id, now, until, end])
        return Challenge(purpose, self._mac(said) + said, domain, origin, rp_id, now, until)

    def open(self, purpose: Purpose, number: bytes) -> Challenge:
        """The challenge with this id; it is not used up.

        Raises:
            OtherChallenge: it is of another purpose, not of this process, was used, or is over.
        """
        mac, said = number[:_MAC], number[_MAC:]
        if not hmac.compare_digest(mac, self._mac(said)):
            raise _other()
        match decode(said):
            case [
                str(found), bytes(), str(domain), str(origin), str(rp_id), int(made), int(until),
                int(end),
            ] if found == purpose:  # fmt: skip
                pass
            case _:
                raise _other()
        with self._lock:
            if number in self._used or self._elapsed() * 1000 >= end:
                raise _other()
        return Challenge(purpose, number, domain, origin, rp_id, made, until)

    def use(self, challenge: Challenge) -> None:
        """Use up a challenge that a passkey has answered.

        Raises:
            OtherChallenge: it was used meanwhile, or so many were that it cannot be remembered.
        """
        with self._lock:
            now = self._elapsed()
            self._used = {number: end for number, end in self._used.items() if now < end}
            if challenge.id in self._used or len(self._used) >= MAX_USED:
                raise _other()
            self._used[challenge.id] = now + LIFETIME

    def _mac(self, said: bytes) -> bytes:
        return hmac.digest(self._key, said, "sha256")


def _other() -> OtherChallenge:
    return OtherChallenge("this was answered before, or took too long", "open the page again")
