"""The `rossec` command: nouns with verbs. A refusal leaves as error and hint, never a traceback."""

import importlib
import logging
import os
import sys
from collections.abc import Mapping, Sequence
from typing import Any, Final, NoReturn

import click

from ca.errors import HintedError
from rossec.cli.context import Environment
from rossec.cli.voice import INTERRUPTED, REFUSED, UNDELIVERED, USAGE, fail, printable
from rossec.errors import NotDelivered

_NOUNS: Final = {  # a noun, and the modules whose COMMANDS are more of its verbs
    "audit": (), "demo": (), "discover": (), "doctor": (), "explain": (),
    "grant": ("request",), "graph": (), "master": ("delegate",),
    "ca": ("ca_identities", "ca_backup", "ca_enroll", "ca_requests", "ca_intermediate", "ca_import",
           "ca_log"),
    "node": ("node_enroll",), "param": (), "policy": (), "privacy": (), "run": (),
    "service": (), "sidecar": (), "simulate": (), "topic": (),
}  # fmt: skip


class Nouns(click.Group):
    """Each noun is a command of the same name in a module of `rossec.cli`.

    It is imported when it is called for: a master that runs for months carries nothing of the rest.
    """

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002 - the base's shape
        """Every noun."""
        return sorted({*_NOUNS, *self.commands})

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The command of a noun."""
        if cmd_name in _NOUNS and cmd_name not in self.commands:
            self.add_command(_complete(cmd_name))
        return super().get_command(ctx, cmd_name)


def _complete(noun: str) -> click.Command:
    command: click.Command = getattr(importlib.import_module(f"rossec.cli.{noun}"), noun)
    for name in _NOUNS[noun]:
        for verb in importlib.import_module(f"rossec.cli.{name}").COMMANDS:
            command.add_command(verb)  # type: ignore[attr-defined]
    return command


@click.group(cls=Nouns, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="rossec", prog_name="rossec", message="%(prog)s %(version)s")
@click.option("--verbose", "-v", is_flag=True, help="log what happens")
def rossec(verbose: bool) -> None:
    """Security and access grants for ROS 1."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(OneLine("rossec: %(levelname)s: %(message)s"))
    logging.basicConfig(level=logging.INFO if verbose else logging.WARNING, handlers=[handler])


class OneLine(logging.Formatter):
    """Log lines that hold what peers sent, and can neither be forged nor steer the terminal."""

    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802 - the base's name
        """One line, arguments included."""
        return printable(super().formatMessage(record))

    def formatException(self, ei: Any) -> str:  # noqa: N802 - the base's name
        """A traceback, indented so that no line of it passes for a log line."""
        lines = super().formatException(ei).split("\n")
        return "\n".join(f"    {printable(line)}" for line in lines)


def main() -> NoReturn:
    """Entry point of the `rossec` program."""
    sys.exit(run(sys.argv[1:], os.environ))


def run(arguments: Sequence[str], environ: Mapping[str, str]) -> int:
    """Run one command line and return its exit code (see `rossec.cli.voice`)."""
    try:
        rossec.main(
            list(arguments), prog_name="rossec", standalone_mode=False, obj=Environment(environ)
        )
    except HintedError as error:
        fail(str(error), error.hint)
        return UNDELIVERED if isinstance(error, NotDelivered) else REFUSED
    except click.ClickException as error:
        return _complain(error)
    except (KeyboardInterrupt, click.Abort, EOFError):
        return INTERRUPTED
    except OSError as error:
        fail(f"{error.filename or 'the system'}: {(error.strerror or str(error)).lower()}")
        return REFUSED
    return 0


def _complain(error: click.ClickException) -> int:
    """What click found wrong with the command line, in our voice."""
    if isinstance(error, click.exceptions.NoArgsIsHelpError):
        click.echo(error.format_message())
        return USAGE
    usage = isinstance(error, click.UsageError)
    fail(_plain(error.format_message()), _usage_hint(error) if usage else "")
    return USAGE if usage else REFUSED


def _plain(message: str) -> str:
    line = " ".join(message.split())
    return (line[:1].lower() + line[1:]).rstrip(".")


def _usage_hint(error: click.ClickException) -> str:
    context = getattr(error, "ctx", None)
    path = context.command_path if context is not None else "rossec"
    return f"see: {path} --help"
