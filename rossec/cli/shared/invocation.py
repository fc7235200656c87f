"""One command line, from arguments to exit code: a refusal is printed as error and hint."""

from collections.abc import Mapping, Sequence
from typing import Final

import click

from ca.errors import HintedError, JoinWaiting
from rossec.cli.shared.context import Environment
from rossec.errors import NotDelivered, PolicyContradicted, PolicyIncomplete
from rossec.terminal import (
    CONTRADICTED,
    INCOMPLETE,
    INTERRUPTED,
    REFUSED,
    UNDELIVERED,
    USAGE,
    WAITING,
    fail,
)

_EXIT_CODES: Final[dict[type[HintedError], int]] = {
    NotDelivered: UNDELIVERED,
    PolicyContradicted: CONTRADICTED,
    PolicyIncomplete: INCOMPLETE,
    JoinWaiting: WAITING,
}


def run(program: click.Command, arguments: Sequence[str], environ: Mapping[str, str]) -> int:
    """Run one command line and return its exit code (see `rossec.terminal`)."""
    try:
        program.main(
            list(arguments), prog_name="rossec", standalone_mode=False, obj=Environment(environ)
        )
    except HintedError as error:
        fail(str(error), error.hint)
        return _EXIT_CODES.get(type(error), REFUSED)
    except click.ClickException as error:
        return _report(error)
    except (KeyboardInterrupt, click.Abort, EOFError):
        return INTERRUPTED
    except UnicodeEncodeError:  # an argument of octets that are no text, as the system hands it on
        fail("what was given is not text in UTF-8", "write it anew, or rename the file")
        return REFUSED
    except OSError as error:
        fail(f"{error.filename or 'the system'}: {(error.strerror or str(error)).lower()}")
        return REFUSED
    return 0


def _report(error: click.ClickException) -> int:
    """Print a click error as error and hint."""
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
