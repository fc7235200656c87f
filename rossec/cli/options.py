"""Options that several commands share: which policy."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from rossec.cli.context import Environment
from rossec.policyfile import PolicyFile, place


def policy(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add `--policy` to a command."""
    return click.option(
        "--policy",
        "policy_path",
        type=click.Path(path_type=Path, dir_okay=False),
        help="this policy, instead of ca/policy.yaml in ROSSEC_HOME",
    )(command)


def read_policy(environment: Environment, given: Path | None) -> PolicyFile:
    """The policy a command is about.

    Raises:
        ConfigurationError, PolicyRefused: there is none, or it has mistakes.
    """
    return PolicyFile.read(place(environment.home, given))
