"""What every command shares: its environment, groups that import it when it runs, and its exit code.

A refusal is printed as error and hint. Help and completion list commands unimported.
"""

import importlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import click

from ca.errors import HintedError, JoinWaiting
from rossec import errors, terminal

_UNITS: Final = {"s": 1, "m": 60, "h": 3600, "d": 86400, "w": 7 * 86400}
_ANSWER: Final = "answer y, or give --yes where no one can answer"
_DURATION: Final = re.compile(r"([1-9][0-9]{0,5})([smhdw])", re.ASCII)


@dataclass(frozen=True)
class Environment:
    """The process environment of one command line, and the masters that it has found.

    `found`: by the key of an authority, the URI of its master or why there is none (see `shared.master`).
    """

    variables: Mapping[str, str]
    found: dict[bytes, str | errors.MasterNotFound] = field(default_factory=dict, compare=False)

    @property
    def home(self) -> Path:
        from rossec.environment import own_home  # noqa: PLC0415 - not needed for help and completion

        return own_home(self.variables)


pass_environment = click.make_pass_decorator(Environment)


def now() -> int:
    from rossec import clock  # noqa: PLC0415 - not needed for help and completion

    return clock.now()


class Duration(click.ParamType[int]):
    """A duration such as 30s, 15m, 8h, 7d or 4w, as seconds."""

    name = "duration"

    def __init__(self, days: int | None = None) -> None:
        self._days = days

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> int:
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
        self._duration = Duration(most // _UNITS["d"])

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> int:
        return 0 if value in {0, "0"} else self._duration.convert(value, param, ctx)


def reraise_interrupt(abort: click.Abort) -> None:
    """Distinguish Ctrl-C from the end of input: click raises `Abort` for both."""
    # 130 says to a shell that the user ended it; the end of input is a question without an answer.
    if isinstance(abort.__context__, KeyboardInterrupt):
        raise KeyboardInterrupt from None


def confirm(question: str, *, yes: bool) -> None:
    """Ask, unless `--yes` was given."""
    if not ask_yes_no(question, yes=yes):
        raise errors.ConfigurationError("nothing was done", _ANSWER)


def ask_yes_no(question: str, *, yes: bool) -> bool:
    """As `confirm`, but return the answer."""
    if yes:
        return True
    try:
        # On stderr: with --json stdout is one document (decision 0044). Enter alone decides nothing.
        return click.confirm(terminal.printable(question), default=False, err=True)
    except click.Abort as abort:
        reraise_interrupt(abort)
        raise errors.ConfigurationError("there was no answer, nothing was done", _ANSWER) from None


_EXIT_CODES: Final[dict[type[HintedError], int]] = {
    errors.NotDelivered: terminal.UNDELIVERED,
    errors.PolicyContradicted: terminal.CONTRADICTED,
    errors.PolicyIncomplete: terminal.INCOMPLETE,
    JoinWaiting: terminal.WAITING,
}


def run(program: click.Command, arguments: Sequence[str], environ: Mapping[str, str]) -> int:
    """Run one command line and return its exit code (see `rossec.terminal`)."""
    try:
        program.main(list(arguments), prog_name="rossec", standalone_mode=False, obj=Environment(environ))
    except HintedError as error:
        terminal.fail(str(error), error.hint)
        # Scripts tell what was signed but not delivered from what was refused (decision 0044).
        return _EXIT_CODES.get(type(error), terminal.REFUSED)
    except click.ClickException as error:
        return _report(error)
    except (KeyboardInterrupt, click.Abort, EOFError):
        return terminal.INTERRUPTED
    except UnicodeEncodeError:  # an argument of octets that are no text, as the system hands it on
        terminal.fail("what was given is not text in UTF-8", "write it anew, or rename the file")
        return terminal.REFUSED
    # A full disk or a file of another user is said as any refusal: no traceback reaches a person.
    except OSError as error:
        terminal.fail(f"{error.filename or 'the system'}: {(error.strerror or str(error)).lower()}")
        return terminal.REFUSED
    return 0


def _report(error: click.ClickException) -> int:
    if isinstance(error, click.exceptions.NoArgsIsHelpError):
        click.echo(error.format_message())
        return terminal.USAGE
    line = " ".join(error.format_message().split())
    text = (line[:1].lower() + line[1:]).rstrip(".")
    if not isinstance(error, click.UsageError):
        terminal.fail(text)
        return terminal.REFUSED
    path = "rossec" if error.ctx is None else error.ctx.command_path
    terminal.fail(text, f"see: {path} --help")
    return terminal.USAGE


class LazyCommand(click.Command):
    """A command that is listed: its name, and the place in `rossec.cli` it is imported from.

    `arguments`: which names complete its arguments that are text, in order (`completion.values.KINDS`).
    """

    def __init__(self, name: str, place: str, *arguments: str) -> None:
        super().__init__(name)
        self.place = place
        self.arguments = arguments

    def get_short_help_str(self, limit: int = 45) -> str:  # noqa: ARG002 - as the base has it
        """The first sentence of its help, whole: the list wraps it, click would cut it."""
        from rossec.cli.completion.shells import outline  # noqa: PLC0415 - not needed to run a command

        return str(outline(self.place, self.load)["help"])

    def load(self) -> click.Command:
        # All commands together import for half a second, of which one needs a part (decision 0046).
        module, _, attribute = self.place.partition(":")
        command: click.Command = getattr(importlib.import_module(f"rossec.cli.{module}"), attribute)
        return command


class LazyGroup(click.Group):
    """A group made from a table: for each name a place, or one with its arguments, see `LazyCommand`."""

    def __init__(self, *args: Any, table: Mapping[str, str | tuple[str, ...]], **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        for name, listed in table.items():
            self.add_command(LazyCommand(name, *([listed] if isinstance(listed, str) else listed)))

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        name, command, rest = super().resolve_command(ctx, args)
        if isinstance(command, LazyCommand):
            # Tab is answered in 0.06 s from outlines; the modules take 0.5 s to import (decision 0046).
            if ctx.resilient_parsing:  # for completion, whatever it needs to know of the command
                from rossec.cli.completion.shells import completed  # noqa: PLC0415

                found = completed(command.name or "", command.place, command.load, command.arguments)
                return name, found, rest
            command = command.load()
        return name, command, rest
