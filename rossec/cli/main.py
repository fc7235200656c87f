"""The `rossec` command: nouns with verbs. A refusal leaves as error and hint, never a traceback."""

import logging
import os
import sys
from collections.abc import Mapping, Sequence
from typing import Any, Final, NoReturn

import click

from rossec import __version__
from rossec.cli.shared import context
from rossec.cli.shared.context import Environment, LazyGroup
from rossec.cli.shared.options import flag
from rossec.terminal import printable

_TABLE: Final[dict[str, str | tuple[str, ...]]] = {
    "audit": "audit:audit",
    "border": "servers:border",
    "ca": "nouns:ca",
    "completion": "completion.shells:completion",
    "console": "servers:console",
    "demo": "demo:demo",
    "discover": "ros.graph:discover",
    "doctor": ("node.doctor:doctor", "own node"),
    "domain": "nouns:domain",
    "explain": ("policy.explain:explain", "node", "right", "topic or service"),
    "federation": "nouns:federation",
    "gateway": "servers:gateway",
    "grant": "nouns:grant",
    "graph": "ros.graph:graph",
    "master": "servers:master",
    "namespace": "nouns:namespace",
    "node": "nouns:node",
    "param": "nouns:param",
    "policy": "nouns:policy",
    "privacy": "nouns:privacy",
    "relay": "servers:relay",
    "router": "servers:router",
    "run": ("node.sidecar:run", "command"),
    "service": "nouns:service",
    "sidecar": "node.sidecar:sidecar",
    "simulate": "policy.simulate:simulate",
    "topic": "nouns:topic",
}


@click.group(cls=LazyGroup, table=_TABLE, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="rossec", message="%(prog)s %(version)s")
@flag("--verbose -v", "log what happens")
def rossec(verbose: bool) -> None:
    """Security and access grants for ROS 1."""
    handler = logging.StreamHandler(sys.stderr)
    # A peer's name or a broken file may be in a log line: it stays one line, without control characters.
    handler.setFormatter(OneLine("rossec: %(levelname)s: %(message)s"))
    logging.basicConfig(level=logging.INFO if verbose else logging.WARNING, handlers=[handler])


class OneLine(logging.Formatter):
    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802 - the base's name
        return printable(super().formatMessage(record))

    def formatException(self, ei: Any) -> str:  # noqa: N802 - the base's name
        # A traceback, indented so that no line of it passes for a log line.
        lines = super().formatException(ei).split("\n")
        return "\n".join(f"    {printable(line)}" for line in lines)


def main() -> NoReturn:
    sys.exit(run(sys.argv[1:], os.environ))


def run(arguments: Sequence[str], environ: Mapping[str, str]) -> int:
    return context.run(rossec, arguments, environ)


def complete(environ: Mapping[str, str]) -> str:
    from rossec.cli.completion import shells  # noqa: PLC0415 - for completion alone

    return shells.answer(rossec, Environment(environ))
