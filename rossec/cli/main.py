"""The `rossec` command: nouns with verbs. Every refusal leaves as error and hint, never a traceback."""

import logging
import sys
from importlib.metadata import version
from typing import Annotated

import click
import typer

from ca.errors import HintedError
from rossec.cli import ca, demo, grant, master, node, topic
from rossec.cli.voice import INTERRUPTED, REFUSED, USAGE, fail, say

app = typer.Typer(
    name="rossec",
    help="Security and access grants for ROS 1.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
app.add_typer(ca.app, name="ca")
app.add_typer(node.app, name="node")
app.add_typer(grant.app, name="grant")
app.add_typer(topic.app, name="topic")
app.command("master")(master.run)
app.command("demo")(demo.run)


def _version(wanted: bool) -> None:
    if wanted:
        say(f"rossec {version('rossec')}")
        raise typer.Exit


@app.callback()
def options(
    _version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="show the version")
    ] = False,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="log what happens")] = False,
) -> None:
    """Security and access grants for ROS 1."""
    logging.basicConfig(
        level=logging.INFO if verbose else logging.WARNING,
        format="rossec: %(levelname)s: %(message)s",
        stream=sys.stderr,
    )


def main() -> None:
    """Entry point: run the command and turn every refusal into an exit code."""
    sys.exit(run(sys.argv[1:]))


def run(arguments: list[str]) -> int:
    """Run one command line and return its exit code."""
    try:
        result = app(arguments, prog_name="rossec", standalone_mode=False)
    except HintedError as error:
        fail(str(error), error.hint)
        return REFUSED
    except click.UsageError as error:
        fail(_plain(error.format_message()), _usage_hint(error))
        return USAGE
    except click.ClickException as error:
        fail(_plain(error.format_message()))
        return REFUSED
    except (KeyboardInterrupt, click.Abort, EOFError):
        return INTERRUPTED
    except BrokenPipeError:
        return REFUSED
    except OSError as error:
        fail(f"{error.filename or 'the system'}: {(error.strerror or str(error)).lower()}")
        return REFUSED
    return result if isinstance(result, int) else 0


def _plain(message: str) -> str:
    return (message[:1].lower() + message[1:]).rstrip(".")


def _usage_hint(error: click.UsageError) -> str:
    path = error.ctx.command_path if error.ctx is not None else "rossec"
    return f"see: {path} --help"
