"""What every command shares: the environment it was called with, and what follows from it."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import click

from rossec.errors import ConfigurationError, MasterNotFound
from rossec.terminal import printable

_UNITS: Final = {"s": 1, "m": 60, "h": 3600, "d": 86400, "w": 7 * 86400}
_ANSWER: Final = "answer y, or give --yes where no one can answer"
_DURATION: Final = re.compile(r"([1-9][0-9]{0,5})([smhdw])", re.ASCII)


@dataclass(frozen=True)
class Environment:
    """The process environment of one command line, and the masters that it has found.

    Attributes:
        found: by the key of an authority, the URI of its master or why there is none (see
            `rossec.cli.shared.master`).
    """

    variables: Mapping[str, str]
    found: dict[bytes, str | MasterNotFound] = field(default_factory=dict, compare=False)

    @property
    def home(self) -> Path:
        """ROSSEC_HOME, if no other user can write there."""
        from rossec.environment import own_home  # noqa: PLC0415 - not needed for help and completion

        return own_home(self.variables)


pass_environment = click.make_pass_decorator(Environment)


def now() -> int:
    """Seconds since the epoch, host clock."""
    from rossec import clock  # noqa: PLC0415 - not needed for help and completion

    return clock.now()


class Duration(click.ParamType[int]):
    """A duration such as 30s, 15m, 8h, 7d or 4w, as seconds."""

    name = "duration"

    def __init__(self, days: int | None = None) -> None:
        """Allow at most `days` days."""
        self._days = days

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> int:
        """Seconds of the duration `value`."""
        if isinstance(value, int):
            return value
        match = _DURATION.fullmatch(str(value))
        if match is None:
            self.fail(f"{value!r} is not a duration; write 30s, 15m, 8h, 7d or 4w", param, ctx)
        seconds = int(match[1]) * _UNITS[match[2]]
        if self._days is not None and seconds > self._days * _UNITS["d"]:
            self.fail(f"{value} is too long; at most {self._days}d are allowed", param, ctx)
        return seconds


class UnlockTime(click.ParamType[int]):
    """A duration as seconds, or 0 for no end."""

    name = "duration"

    def __init__(self, most: int) -> None:
        """Allow at most `most` seconds."""
        self._duration = Duration(most // _UNITS["d"])

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> int:
        """Seconds of the duration `value`; 0: no end."""
        return 0 if value in {0, "0"} else self._duration.convert(value, param, ctx)


def reraise_interrupt(abort: click.Abort) -> None:
    """Distinguish Ctrl-C from the end of input: click raises `Abort` for both.

    Raises:
        KeyboardInterrupt: it was Ctrl-C.
    """
    if isinstance(abort.__context__, KeyboardInterrupt):
        raise KeyboardInterrupt from None


def confirm(question: str, *, yes: bool) -> None:
    """Ask, unless `--yes` was given.

    Raises:
        ConfigurationError: the answer was no, or there was none.
        KeyboardInterrupt: Ctrl-C.
    """
    if not ask_yes_no(question, yes=yes):
        raise ConfigurationError("nothing was done", _ANSWER)


def ask_yes_no(question: str, *, yes: bool) -> bool:
    """As `confirm`, but return the answer.

    Raises:
        ConfigurationError: there was no answer.
        KeyboardInterrupt: Ctrl-C.
    """
    if yes:
        return True
    try:
        return click.confirm(printable(question), default=False, err=True)
    except click.Abort as abort:
        reraise_interrupt(abort)
        raise ConfigurationError("there was no answer, nothing was done", _ANSWER) from None
