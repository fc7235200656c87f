"""Texts of peers, made safe for a log: a line break in one would forge log lines."""

import unicodedata
from typing import Final

TEXT_LIMIT: Final = 1000
_CUT: Final = "..."
_HARMFUL: Final = frozenset({"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"})


def printable(text: object, limit: int = TEXT_LIMIT) -> str:
    """One bounded line: control, direction and line characters are escaped, the rest is cut off."""
    whole = str(text)
    shown = "".join(char if _harmless(char) else _escaped(char) for char in whole[:limit])
    return shown if len(whole) <= limit else shown + _CUT


def _harmless(char: str) -> bool:
    return unicodedata.category(char) not in _HARMFUL


def _escaped(char: str) -> str:
    return f"\\u{ord(char):04x}" if ord(char) <= 0xFFFF else f"\\U{ord(char):08x}"
