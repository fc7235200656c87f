"""Mistakes in a policy file: position, message, and the value that was probably meant.

Reading continues after a mistake, so that all of them are reported at once; then the file is
refused as a whole. A `Policy` never has mistakes.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import NoReturn, Protocol

from ca.suggestions import closest
from grants.errors import PolicyRefused

MAX_MISTAKES = 200  # more are not useful, and a hostile file must not cause a long report
_MAX_SUGGESTIONS = 12


class SourcePosition(Protocol):
    """A position in the file, line and column counted from 1."""

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

    def add(self, position: SourcePosition, message: str, hint: str = "") -> None:
        """Record one mistake.

        Raises:
            PolicyRefused: the maximum number is reached.
        """
        self.found.append(Mistake(position.line, position.column, message, hint, self.file))
        if len(self.found) >= MAX_MISTAKES:
            self.raise_all()

    def raise_if_any(self) -> None:
        """Raise `PolicyRefused` with all mistakes, in the order of the file, if there are any.

        Raises:
            PolicyRefused: there are mistakes.
        """
        if self.found:
            self.raise_all()

    def raise_all(self) -> NoReturn:
        """Raise `PolicyRefused` with all mistakes so far, at least one."""
        ordered = tuple(sorted(set(self.found)))
        more = len(ordered) - 1
        rest = f" (and {more} more, see: rossec policy check {self.file})" if more else ""
        raise PolicyRefused(f"{ordered[0]}{rest}", ordered[0].hint, ordered)


def suggest(value: str, known: Iterable[str]) -> str:
    """A hint: the most similar known value, or a list of them."""
    values = sorted({str(each) for each in known})  # members of a StrEnum as what is written
    if (close := closest(value, values)) is not None:
        return f"did you mean {close!r}?"
    if not values:
        return "none is defined"
    more = ", ..." if len(values) > _MAX_SUGGESTIONS else ""
    return f"expected one of {', '.join(values[:_MAX_SUGGESTIONS])}{more}"
