"""Challenges for passkeys that approve nothing: of a login, and of a new passkey. Pure.

Their first field differs from that of a statement, and so does the type that a browser signs for a
new passkey: nothing signed for one purpose is ever taken for another. The service takes each once.
"""

from enum import StrEnum
from hashlib import sha256
from typing import NamedTuple

from ca.encoding import encode


class Purpose(StrEnum):
    """What a challenge is for."""

    LOGIN = "rossec-login-v1"
    PASSKEY = "rossec-passkey-v1"


class Challenge(NamedTuple):
    """One challenge; `id` has 16 random bytes, `until` is its last second."""

    purpose: Purpose
    id: bytes
    domain: str
    origin: str
    rp_id: str
    made: int
    until: int

    @property
    def digest(self) -> bytes:
        """The 32 bytes that the passkey signs."""
        return sha256(encode([str(self.purpose), *self[1:]])).digest()
