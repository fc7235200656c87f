"""roff, as man(7) has it: text that can hold any character, and the few macros of our pages. Pure.

A hyphen is written as a minus, so that an option can be copied from the page; accents and quotes as
the ASCII characters they are (groff_char(7), "Basic Latin").
"""

import re
from collections.abc import Iterable
from typing import Final

_ESCAPED: Final = {
    "\\": r"\e", "-": r"\-", "^": r"\(ha", "~": r"\(ti", "`": r"\(ga", "'": r"\(aq", '"': r"\(dq",
}  # fmt: skip
_SPECIAL: Final = re.compile(r"""[\\^~`'"-]|[^\x20-\x7e]""")
_FONT: Final = {"B": r"\fB", "I": r"\fI"}


def escape(text: str) -> str:
    """`text` on one line, as roff prints it; a control character is a space."""
    line = _SPECIAL.sub(_character, text)
    return rf"\&{line}" if line[:1] == "." else line


def _character(match: re.Match[str]) -> str:
    found = match[0]
    if found in _ESCAPED:
        return _ESCAPED[found]
    return rf"\[u{ord(found):04X}]" if found.isprintable() else " "


def bold(text: str) -> str:
    """Escaped, and bold."""
    return rf"\fB{escape(text)}\fR"


def italic(text: str) -> str:
    """Escaped, and in italics."""
    return rf"\fI{escape(text)}\fR"


def title(name: str, source: str) -> str:
    """The first line of the page `name` of section 1. It has no date: a build can be repeated."""
    return f'.TH "{escape(name.upper())}" 1 "" "{escape(source)}" "rossec manual"'


def section(heading: str) -> str:
    """A section."""
    return f'.SH "{escape(heading)}"'


def subsection(heading: str) -> str:
    """A part of a section."""
    return f'.SS "{escape(heading)}"'


def paragraph(text: str) -> list[str]:
    """A paragraph, whose lines are filled anew."""
    return [".PP", escape(" ".join(text.split()))]


def verbatim(lines: Iterable[str]) -> list[str]:
    """Lines that stay as they are, indented."""
    return [
        ".PP",
        ".RS 4",
        ".nf",
        *(escape(line.rstrip()) or r"\&" for line in lines),
        ".fi",
        ".RE",
    ]


def item(term: str, text: str) -> list[str]:
    """A term, which is escaped already, and what it means."""
    return [".TP", term, escape(" ".join(text.split())) or r"\&"]
