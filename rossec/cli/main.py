"""The `rossec` command: nouns with verbs. A refusal leaves as error and hint, never a traceback."""

import logging
import os
import sys
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from typing import Any, NoReturn

import click

from ca.errors import HintedError
from rossec.cli import ca_backup, ca_identities, ca_requests, node_enroll
from rossec.cli.ca import ca
from rossec.cli.ca_enroll import enroll
from rossec.cli.ca_intermediate import intermediate
from rossec.cli.ca_log import log
from rossec.cli.context import Environment
from rossec.cli.demo import demo
from rossec.cli.explain import explain
from rossec.cli.grant import grant
from rossec.cli.graph import graph
from rossec.cli.master import master
from rossec.cli.node import node
from rossec.cli.param import param
from rossec.cli.policy import policy
from rossec.cli.privacy import privacy
from rossec.cli.request import COMMANDS
from rossec.cli.service import service
from rossec.cli.simulate import simulate
from rossec.cli.topic import topic
from rossec.cli.voice import INTERRUPTED, REFUSED, UNDELIVERED, USAGE, fail, printable
from rossec.errors import NotDelivered


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(version("rossec"), prog_name="rossec", message="%(prog)s %(version)s")
@click.option("--verbose", "-v", is_flag=True, help="log what happens")
def rossec(verbose: bool) -> None:
    """Security and access grants for ROS 1."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(OneLine("rossec: %(levelname)s: %(message)s"))
    logging.basicConfig(level=logging.INFO if verbose else logging.WARNING, handlers=[handler])


for command in (
    ca,
    node,
    grant,
    policy,
    explain,
    simulate,
    privacy,
    master,
    graph,
    topic,
    service,
    param,
    demo,
):
    rossec.add_command(command)
for command in (*ca_identities.COMMANDS, *ca_backup.COMMANDS, intermediate, log):
    ca.add_command(command)
for command in COMMANDS:
    grant.add_command(command)
for command in (enroll, *ca_requests.COMMANDS):
    ca.add_command(command)
for command in node_enroll.COMMANDS:
    node.add_command(command)


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
    first = message.splitlines()[0]
    return (first[:1].lower() + first[1:]).rstrip(".")


def _usage_hint(error: click.ClickException) -> str:
    context = getattr(error, "ctx", None)
    path = context.command_path if context is not None else "rossec"
    return f"see: {path} --help"
