"""Colour for a person at a terminal: only beside words that say the same, never alone.

There is none where the stream is no terminal, where TERM is `dumb` or not set, and where NO_COLOR
is set and not empty (https://no-color.org).
"""

import os
import re
from collections.abc import Mapping
from typing import Final, TextIO

RED: Final = "31"
GREEN: Final = "32"
YELLOW: Final = "33"
BOLD: Final = "1"

STATES: Final = {
    "ok": GREEN, "held": GREEN, "delivered": GREEN, "valid": GREEN, "in force": GREEN,
    "not ok": RED, "revoked": RED, "denied": RED, "refused": RED,
    "expired": YELLOW, "stale": YELLOW, "waiting": YELLOW, "unknown": YELLOW,
}  # fmt: skip

PAINTED: Final = re.compile(
    "(\x1b\\[(?:{})m *(?:{}) *\x1b\\[0m)".format("|".join({*STATES.values()}), "|".join(STATES))
)
"""A state as `state` paints it, and no other sequence that steers a terminal."""


def is_wanted(stream: TextIO, environ: Mapping[str, str] | None = None) -> bool:
    """Whether what is written to `stream` may be coloured."""
    found = os.environ if environ is None else environ
    return (
        not found.get("NO_COLOR")
        and found.get("TERM", "dumb") != "dumb"
        and not stream.closed
        and stream.isatty()
    )


def paint(text: str, colour: str, stream: TextIO) -> str:
    """`text` in a colour, if that is wanted on `stream`; `text` holds no control character."""
    return f"\x1b[{colour}m{text}\x1b[0m" if colour and is_wanted(stream) else text


def state(word: str, stream: TextIO) -> str:
    """A state in its colour; spaces around it are kept."""
    return paint(word, STATES.get(word.strip(), ""), stream)
