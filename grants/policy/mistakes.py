"""What is wrong in a policy file: where, what, and the word that was probably meant.

Reading goes on after a mistake, so that all of them are reported at once; only then is the file
refused as a whole. A policy that exists has none.
"""

import difflib
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import NoReturn, Protocol

from grants.errors import PolicyRefused

MAX_MISTAKES = 200  # nobody reads further, and a hostile file may not make us write a book
_MAX_WORDS = 12


class SourcePosition(Protocol):
    """Something that has a place in the file, both counted from 1."""

    @property
    def line(self) -> int:
        """Line."""

    @property
    def column(self) -> int:
        """Column."""


@dataclass(frozen=True, order=True)
class Mistake:
    """One mistake, in the form editors jump to: `file:line:column: message`."""

    line: int
    column: int
    message: str
    hint: str
    file: str = ""

    def __str__(self) -> str:
        return f"{self.file}:{self.line}:{self.column}: {self.message}"


@dataclass
class Mistakes:
    """Collects the mistakes of one file."""

    file: str
    found: list[Mistake] = field(default_factory=list)

    def add(self, place: SourcePosition, message: str, hint: str = "") -> None:
        """Note one mistake.

        Raises:
            PolicyRefused: there are so many that to go on would be work for nobody.
        """
        self.found.append(Mistake(place.line, place.column, message, hint, self.file))
        if len(self.found) >= MAX_MISTAKES:
            self.refuse()

    def refuse_any(self) -> None:
        """Return if there are none.

        Raises:
            PolicyRefused: with all of them, in the order of the file.
        """
        if self.found:
            self.refuse()

    def refuse(self) -> NoReturn:
        """Raise `PolicyRefused` with everything found so far, which is something."""
        ordered = tuple(sorted(set(self.found)))
        more = len(ordered) - 1
        rest = f" (and {more} more, see: rossec policy check {self.file})" if more else ""
        raise PolicyRefused(f"{ordered[0]}{rest}", ordered[0].hint, ordered)


def suggest(word: str, known: Iterable[str]) -> str:
    """A hint: the known word that was probably meant, or a choice of them."""
    words = sorted(set(known))
    close = difflib.get_close_matches(word, words, 1, 0.6)
    if close:
        return f"did you mean {close[0]!r}?"
    if not words:
        return "there are none"
    more = ", ..." if len(words) > _MAX_WORDS else ""
    return f"there are {', '.join(words[:_MAX_WORDS])}{more}"
