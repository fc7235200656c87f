"""Who has what was begun at the console: a phone, or a session that may only look. Pure.

The console says it with what it asks; shares of bounded tables go by it (`rossec.shares`), and
rights do not. A phone is the owner's, so nothing that a looker begins ends what a phone began.
"""

from typing import Final

LOOKER: Final = "look"
"""Everybody who may only look, where they share one place."""

_PHONE: Final = "phone "
MAX_OWNER: Final = 200  # characters


def of_phone(name: str) -> str:
    """All sessions of a phone."""
    return f"{_PHONE}{name}"


def of_looker(session: bytes) -> str:
    """One session that may only look."""
    return f"{LOOKER} {session.hex()}"


def rank(owner: str) -> int:
    """1: of a phone; 0: of whoever may only look."""
    return int(owner.startswith(_PHONE))
