"""The `rossec` command: nouns with verbs. A refusal leaves as error and hint, never a traceback."""

import importlib
import logging
import os
import sys
from collections.abc import Mapping, Sequence
from typing import Any, Final, NoReturn

import click

from rossec.cli.shared import invocation
from rossec.terminal import printable

_NOUNS: Final = {  # a noun's module, and those whose COMMANDS are more of its verbs
    "audit": ("master.audit",),
    "ca": ("ca.group", "ca.identities", "ca.backup", "ca.enroll", "ca.requests", "ca.intermediate",
           "ca.import_identities", "ca.log"),
    "demo": ("demo",),
    "discover": ("master.discover",),
    "doctor": ("node.doctor",),
    "explain": ("policy.explain",),
    "grant": ("grant.group", "grant.request"),
    "graph": ("ros.graph",),
    "master": ("master.group", "master.delegate"),
    "node": ("node.group", "node.enroll"),
    "param": ("ros.param",),
    "policy": ("policy.group",),
    "privacy": ("policy.privacy",),
    "run": ("node.run",),
    "service": ("ros.service",),
    "sidecar": ("node.sidecar",),
    "simulate": ("policy.simulate",),
    "topic": ("ros.topic",),
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
    own, *more = (importlib.import_module(f"rossec.cli.{name}") for name in _NOUNS[noun])
    command: click.Command = getattr(own, noun)
    for module in more:
        for verb in module.COMMANDS:
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
    """Run one command line and return its exit code (see `rossec.terminal`)."""
    return invocation.run(rossec, arguments, environ)
