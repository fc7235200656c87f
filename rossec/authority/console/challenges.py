"""Challenges of logins and new passkeys that were made here: each is taken once. In memory."""

import secrets
import threading
from collections.abc import Callable
from typing import Final

from ca.approvals.challenges import Challenge, Purpose
from ca.errors import OtherChallenge
from rossec import clock

LIFETIME: Final = 300  # seconds
MAX_CHALLENGES: Final = 64  # of one purpose; one more ends the oldest


class Challenges:
    """The challenges that were not answered yet; threads may share it."""

    def __init__(
        self,
        elapsed: clock.Seconds | None = None,
        random: Callable[[int], bytes] = secrets.token_bytes,
    ) -> None:
        self._elapsed = clock.counter() if elapsed is None else elapsed
        self._random = random
        self._lock = threading.Lock()
        self._made: dict[Purpose, dict[bytes, tuple[Challenge, float]]] = {
            purpose: {} for purpose in Purpose
        }

    def make(self, purpose: Purpose, domain: str, origin: str, rp_id: str, now: int) -> Challenge:
        """A new challenge, for the page at `origin`."""
        number, until = self._random(16), now + LIFETIME
        challenge = Challenge(purpose, number, domain, origin, rp_id, now, until)
        with self._lock:
            made = self._made[purpose]
            if len(made) >= MAX_CHALLENGES:
                del made[next(iter(made))]
            made[number] = challenge, self._elapsed() + LIFETIME
        return challenge

    def take(self, purpose: Purpose, number: bytes) -> Challenge:
        """The challenge with this id, which is used up.

        Raises:
            OtherChallenge: there is none for this purpose, or not any more.
        """
        with self._lock:
            challenge, end = self._made[purpose].pop(number, (None, 0.0))
        if challenge is None or self._elapsed() >= end:
            raise OtherChallenge(
                "this was answered before, or took too long", "open the page again"
            )
        return challenge
