"""The `rossec` command: nouns with verbs. A refusal leaves as error and hint, never a traceback."""

import logging
import os
import sys
from collections.abc import Mapping, Sequence
from typing import Any, Final, NoReturn

import click

from rossec.cli.shared import invocation
from rossec.cli.shared.context import Environment
from rossec.cli.shared.lazy import LazyGroup
from rossec.terminal import printable

_TABLE: Final = {
    "audit": (
        "master.audit:audit",
        "Show the master's audit: what was denied, and what was administered.",
    ),
    "border": (
        "border.group:border",
        "Run the border router of constrained things, as the node /border.",
    ),
    "ca": ("ca.group:ca", "Run the authority, which signs the identities."),
    "completion": (
        "completion.command:completion",
        "Print what makes Tab complete commands and names in SHELL: bash, zsh or fish.",
    ),
    "console": (
        "console.group:console",
        "Show who sees what, and decide: pages for a browser, and the phones that approve.",
    ),
    "demo": ("demo:demo", "Show the main job: enroll, grant, filter, refuse, revoke."),
    "discover": (
        "master.discover:discover",
        "Look for the masters of this trust domain, the best link first.",
    ),
    "doctor": (
        "node.doctor:doctor",
        "Check the set-up of NODE on this machine: identity, grants, master, what is plain.",
    ),
    "domain": ("domain.group:domain", "Trust other domains, as far as you say."),
    "explain": (
        "policy.explain:explain",
        "Show whether NODE may use RIGHT (subscribe, publish, call, ...) on NAME, and why.",
    ),
    "federation": (
        "federation.group:federation",
        "Follow other masters: of the own domain, and of domains that are trusted.",
    ),
    "gateway": (
        "gateway.group:gateway",
        "Run the gateway of this site, as the node /gateway.",
    ),
    "grant": ("grant.group:grant", "Sign, show and revoke grants."),
    "graph": ("ros.graph:graph", "Show the graph, as far as NODE may see it."),
    "master": ("master.group:master", "Run a master, as the node /master."),
    "namespace": (
        "namespace.group:namespace",
        "Give names by rules: to a node, its topics and services, from its metadata.",
    ),
    "node": ("node.group:node", "Prepare a node on its own machine."),
    "param": ("ros.group:param", "Read and write parameters."),
    "policy": ("policy.group:policy", "Write what is allowed, and check it."),
    "privacy": (
        "policy.group:privacy",
        "Show every field of every topic: which node sees it, how, why and until when.",
    ),
    "relay": (
        "relay.group:relay",
        "Run the relay of this site, as the node /relay.",
    ),
    "router": (
        "router.group:router",
        "Run a router, through which relays of several sites reach each other.",
    ),
    "run": (
        "node.run:run",
        "Run COMMAND, a ROS program in any language, behind a sidecar of its own.",
    ),
    "service": ("ros.group:service", "List, ask and call services."),
    "sidecar": (
        "node.sidecar:sidecar",
        "Serve the ROS programs of this host: each node with the identity enrolled for its name.",
    ),
    "simulate": (
        "policy.simulate:simulate",
        "Show per topic and receiver how many messages of a bag pass, before and after.",
    ),
    "topic": ("ros.group:topic", "Publish and listen."),
}


@click.group(cls=LazyGroup, table=_TABLE, context_settings={"help_option_names": ["-h", "--help"]})
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


def complete(environ: Mapping[str, str]) -> str:
    """What completes the command line that a shell described in `environ`."""
    from rossec.cli.completion import shells  # noqa: PLC0415 - for completion alone

    return shells.answer(rossec, Environment(environ))
